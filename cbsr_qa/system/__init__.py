"""What the operating system gives: clocks, files that appear whole, locks, limited child processes."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
