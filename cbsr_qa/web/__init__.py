"""The page of a line: operators see and start runs in a browser; see docs/decisions/0041."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
