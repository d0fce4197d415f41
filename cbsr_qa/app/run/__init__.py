"""Testing one sensor: run, resume, outputs, report rendered again."""
