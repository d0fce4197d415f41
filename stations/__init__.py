"""Shipped station, recipe, sensor type, material and scene files."""
