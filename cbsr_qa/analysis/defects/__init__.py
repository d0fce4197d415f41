"""Defects of readings, found, masked or repaired: of recordings, of runs, and of frames as they arrive."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
