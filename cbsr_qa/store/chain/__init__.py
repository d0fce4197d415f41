"""The chain of digests each run is under, and its check."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
