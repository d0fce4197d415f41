"""What tests of instruments that send lines look at."""

import numpy as np

CELL = {"driver": "serial-load-cell"}


def skipped(cell):
    """Lines it could not read."""
    return cell._source.skipped


def skipped_lines(thermometer):
    """Lines it could not read."""
    return thermometer._lines.skipped


def true_N(station, times):
    numbers = np.round(np.asarray(times) * 8).astype(int)
    return [station.rig.world.force_N(n / 8, int(n)) for n in numbers]
