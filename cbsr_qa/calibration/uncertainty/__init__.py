"""Expanded uncertainties of a calibrated sensor, by the GUM (JCGM 100)."""
