"""A calibration in use: frames in, newtons out. Needs numpy, scipy and h5py alone."""
