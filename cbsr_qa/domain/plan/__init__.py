"""Plans: station, recipe, steps, scene."""
