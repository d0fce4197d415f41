"""Iterative reconstructions: total variation, and absolute Gauss–Newton."""
