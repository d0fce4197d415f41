"""Vocabulary shared by all layers and plugins: errors, numbers, geometry, plans, runs, results."""
