"""Executes steps: dry run, safety, journalling, progress."""
