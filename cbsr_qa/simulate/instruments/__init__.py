"""Emulated instruments on byte streams, all connected to one simulated world."""
