"""A calibration in use: frames in, newtons out. Needs numpy, scipy and h5py alone."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
