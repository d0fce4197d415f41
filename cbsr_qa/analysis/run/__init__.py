"""Analysis of a stored run: reference, loads, relaxations, force."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
