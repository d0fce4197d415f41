"""Readings of a sheet under loads, without a mesh for the loads."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
