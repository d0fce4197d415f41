"""What a sensor's own loads teach: fits, the sheet's response, force, and the file that is issued."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
