"""Gauge R&R of stored runs."""
