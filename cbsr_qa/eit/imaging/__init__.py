"""Regions of images, and their metrics."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
