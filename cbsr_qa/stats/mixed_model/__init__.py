"""Mixed model: groups and stations fixed, sensors random."""
