"""Numerically hard cases, each held against truth: its error and bound, or its named refusal."""
