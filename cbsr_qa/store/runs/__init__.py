"""Runs: stored, read and resumed."""
