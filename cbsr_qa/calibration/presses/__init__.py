"""Calibration from labelled presses, wherever they were made: tables, registration, learned place."""
