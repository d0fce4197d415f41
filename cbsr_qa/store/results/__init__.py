"""Analyses and calibrations."""
