"""Control of a run by others than its own terminal: one lock per station, and a channel to the run that holds it."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
