"""Analysis of a stored run: reference, loads, relaxations, force."""
