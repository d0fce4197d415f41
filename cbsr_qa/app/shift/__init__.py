"""What was tested: runs, sensors, and the yield of a shift."""
