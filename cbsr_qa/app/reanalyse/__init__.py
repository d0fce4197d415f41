"""A changed analysis over many stored runs: values, verdicts that flip, and their adoption."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
