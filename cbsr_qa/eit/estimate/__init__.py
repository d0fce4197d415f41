"""Where a load is and how strong, by maximum likelihood, with its bound."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
