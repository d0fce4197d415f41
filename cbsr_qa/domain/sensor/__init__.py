"""The device under test: sensor type, electrodes, drive pattern, mesh."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
