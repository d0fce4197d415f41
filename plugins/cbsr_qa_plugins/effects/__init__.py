"""Effects of the simulated world."""
