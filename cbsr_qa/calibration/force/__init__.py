"""Conversion of a sensor's readings to newtons: learning, templates, validity."""
