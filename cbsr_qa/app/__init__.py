"""Where things are put together: one function a use case."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
