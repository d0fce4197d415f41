"""The interval of what a batch's sensors have in common holds it as often as it says, and a further map's does."""

import numpy as np
import pytest

from benchmarks.batch_maps import measure as measure_maps
from benchmarks.batch_rho import measure as measure_shares

BATCHES = 80
SENSORS = 10


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.75, 0.9, 0.97])
def test_interval_of_the_share_holds_it(rho):
    low, _, high, _ = measure_shares(rho, SENSORS, BATCHES).T
    held = np.mean((low <= rho) & (rho <= high))
    assert held >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / BATCHES)


@pytest.mark.parametrize("rho", [0.0, 0.75, 0.9])
def test_further_sensors_are_as_sure_as_they_say_and_never_worse_than_alone(rho):
    """Twelve batches of four further sensors; strangers are named after nine presses."""
    for presses, rows in measure_maps("20 mm", rho, SENSORS, 12, 4).items():
        squared, squared_alone, inside, inside_wide, _, _, _, named = rows.mean(axis=(0, 1))
        assert 0.60 < inside < 0.80
        assert 0.91 < inside_wide < 0.99
        assert squared < 1.02**2 * squared_alone
        if rho and presses == 9:
            assert named >= 0.9
