"""GREIT: training targets, imaging matrix, amplitude calibration."""
