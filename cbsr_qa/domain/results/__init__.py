"""What was concluded: measurements, images, relaxations, calibrations, reports."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
