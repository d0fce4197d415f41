"""Tested runs and sensors, and the yield of a shift."""
