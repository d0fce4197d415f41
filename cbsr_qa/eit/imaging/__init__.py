"""Regions of images, and their metrics."""
