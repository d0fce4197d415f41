"""Analysis of stored frames: measurements and a verdict, as pure functions of data and plugins."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
