"""Fits of relaxation, settling, creep and hysteresis to traces of loads."""
