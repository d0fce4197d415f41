"""From press cycles on a strip to its material's parameters."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
