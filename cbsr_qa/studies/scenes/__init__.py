"""Scenes: explanation, costs and recordings."""
