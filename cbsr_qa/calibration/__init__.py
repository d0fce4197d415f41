"""Learning from a sensor's own loads: fits, the sheet's response, force, and the issued file."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
