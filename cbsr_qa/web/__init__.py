"""The page of a line: operators see and start runs in a browser; see docs/decisions/0041."""
