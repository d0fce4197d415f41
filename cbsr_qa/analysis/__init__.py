"""Stored frames to measurements and a verdict: pure functions, given the plugins."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
