"""Calibration files: made from presses, shown, checked, signed, converted, and applied to recordings."""
