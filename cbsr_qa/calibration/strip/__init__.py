"""From press cycles on a strip to its material's parameters."""
