"""Outlines, polygons and footprints, with exact areas and distances."""
