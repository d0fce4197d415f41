"""What instruments deliver: frames, samples, recordings, and what was found in them."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
