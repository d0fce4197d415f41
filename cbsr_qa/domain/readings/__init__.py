"""Data from instruments: frames, samples, recordings and findings in them."""
