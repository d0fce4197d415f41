"""A station at work: bench, dry run, execution, safety."""
