"""Sweeps of the computer's clock."""
