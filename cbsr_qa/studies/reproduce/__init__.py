"""Reproduction of a publication's tables with simulated sensors."""
