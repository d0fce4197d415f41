"""One figure for each effect of the simulated world, by what it acts on."""
