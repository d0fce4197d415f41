"""Accuracy as a function of the number of presses, for the user's own recording."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
