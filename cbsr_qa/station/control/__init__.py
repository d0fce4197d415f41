"""Control of a run by others than its own terminal: one lock per station, and a channel to the run that holds it."""
