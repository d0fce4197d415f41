"""Statistics of lots and stations: pure functions, checked against certified values."""
