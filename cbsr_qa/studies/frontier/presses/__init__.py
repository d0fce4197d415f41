"""Accuracy as a function of the number of presses, for the user's own recording."""
