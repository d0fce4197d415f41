"""The calibration file: HDF5, JSON, firmware."""
