"""Forces as a live stream: from an instrument that takes frames to programs that need newtons."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
