"""How alike the sensors of a stored batch are."""
