"""The chain of digests of a run, and its verification."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
