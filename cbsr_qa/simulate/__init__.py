"""The simulated world: scenes, effects, addressed random streams."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
