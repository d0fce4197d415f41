"""Results: measurements, images, relaxations, calibrations, report content."""
