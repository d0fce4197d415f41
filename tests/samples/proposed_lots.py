"""Sensors of golden lots, for the tests of ``limits propose``."""

from dataclasses import replace

import numpy as np
from stored_lots import judged, measured


def sensor(seed=0, **changes):
    random = np.random.default_rng(seed)
    return judged(measured(random, random.standard_normal(3), **changes))


def lot(count=5, **options):
    return [(f"S-{k}", sensor(k), options) for k in range(1, count + 1)]


def replace_value(measurements, name, value, **changes):
    return tuple(replace(m, value=value, **changes) if m.name == name else m for m in measurements)
