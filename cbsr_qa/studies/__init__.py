"""Studies of many runs, or of many simulations."""
