"""Places of presses on a sheet, learned from presses at known places. In use it needs numpy alone."""
