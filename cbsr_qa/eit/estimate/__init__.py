"""Maximum-likelihood estimate of place and strength of a load, with the Cramér–Rao bound."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
