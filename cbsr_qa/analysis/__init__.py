"""Stored frames to corrected frames, images, events and measurements: pure functions of what is stored."""
