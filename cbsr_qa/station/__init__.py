"""A station at work: bench, dry run, execution, safety."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
