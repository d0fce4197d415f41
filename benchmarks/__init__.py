"""What takes time, as ratios within one run against what a user would pick instead. Run with ``make bench``."""
