"""Numerically hard cases, each compared with a known truth."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
