"""How much to smooth: noise figure, criteria, and what each would choose."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
