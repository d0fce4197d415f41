"""Compares what two commits print, write and store: ``python -m tests.oracle OLD NEW``."""
