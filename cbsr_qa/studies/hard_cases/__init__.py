"""Numerically hard cases, each compared with a known truth."""
