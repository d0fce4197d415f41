"""Calibration files: made from presses, shown, checked, signed, converted, and applied to recordings."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
