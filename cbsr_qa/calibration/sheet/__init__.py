"""Properties of one sheet: response map, baseline, characteristic, data sheet."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
