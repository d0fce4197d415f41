"""Recorded data through the same analysis as a run."""
