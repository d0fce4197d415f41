"""Runs as recorded: events, loads, changes, station checks."""
