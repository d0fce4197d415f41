"""Reconstructions."""
