"""Limits proposed from a golden lot."""
