"""Recording formats."""
