"""Fleets: batches, materials, stations, software versions and periods compared, from rows to sentences."""
