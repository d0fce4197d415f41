"""The page of a line: who stands at the stations sees and starts runs in a browser; see docs/decisions/0041."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
