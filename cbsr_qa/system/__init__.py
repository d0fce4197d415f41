"""Operating system services: clocks, atomic files, locks, limited child processes."""
