"""Quasi-static and relaxation fits, settling, conductance map, the calibration file."""
