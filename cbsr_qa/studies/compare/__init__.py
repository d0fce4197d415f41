"""Batches, materials, stations, software versions and periods compared."""
