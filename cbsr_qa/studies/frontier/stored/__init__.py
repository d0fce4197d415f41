"""What fewer presses and shorter holds would have cost in stored runs."""
