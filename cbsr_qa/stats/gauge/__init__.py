"""Gauge R&R: crossed studies, references, balance."""
