"""Fleets that are not as the simplest model takes them, through the models of ``compare``: claims and intervals."""

import numpy as np
import pytest

from benchmarks.comparison_scenarios import SCENARIOS, measure

FLEETS = 1000


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_claims_are_seldom_false_and_intervals_hold(scenario):
    """False claims of at most 7 %, and 95 % intervals that hold in 93 to 97 %, within three standard errors."""
    shares = measure(scenario, FLEETS)
    false_claims, batches_hold, stations_hold, found = shares["compare"]
    assert false_claims <= 0.07 + 3 * np.sqrt(0.07 * 0.93 / FLEETS)
    # Intervals of the metrics of a fleet are independent; those of a metric are not.
    room = 3 * np.sqrt(0.05 * 0.95 / (10 * FLEETS))
    assert 0.93 - room <= batches_hold <= 0.97 + room
    assert 0.93 - room <= stations_hold <= 0.97 + room
    if scenario == "base":
        assert found >= shares["additive model"][3] - 0.05
