"""Batches, materials, stations, software versions and periods compared."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
