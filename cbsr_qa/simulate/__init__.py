"""The simulated world: scenes, effects, addressed random streams."""
