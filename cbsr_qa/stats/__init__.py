"""Statistics of lots: pure functions of numbers, each checked against certified or printed values."""
