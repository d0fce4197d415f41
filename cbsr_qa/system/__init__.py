"""Operating system services: clocks, atomic files, locks, limited child processes."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
