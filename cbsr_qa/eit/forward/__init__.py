"""Complete electrode model: solution, local updates, derivatives, closed forms."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
