"""What was tested: runs, sensors, and the yield of a shift."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
