"""Data from instruments: frames, samples, recordings and findings in them."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
