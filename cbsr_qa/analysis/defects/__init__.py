"""Defects of readings, found, masked or repaired: of recordings, of runs, and of frames as they arrive."""
