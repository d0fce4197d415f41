"""Accuracy against the number of presses, on presses of one's own."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
