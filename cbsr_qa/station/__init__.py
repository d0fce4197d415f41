"""A station at work: bench, dry run, steps carried out, safety."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
