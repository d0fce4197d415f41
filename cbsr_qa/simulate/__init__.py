"""The simulated world: scenes, the chain of enabled effects, addressed random streams."""
