"""Analysis of stored frames: measurements and a verdict, as pure functions of data and plugins."""
