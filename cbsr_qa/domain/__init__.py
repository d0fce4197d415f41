"""Words of the trade, which every layer and every plugin may use: errors, numbers, and rooms for the rest."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
