"""Calibration from labelled presses, wherever they were made: tables, registration, learned place."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
