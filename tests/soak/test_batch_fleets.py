"""A thousand fleets of known truth through ``compare``: the batch that differs is found, and no station for it."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from compared_fleets import run_of, table_of

from benchmarks.batch_coverage import BATCHES, DESIGNS, design, values
from cbsr_qa.studies.compare.comparison import compare
from cbsr_qa.studies.compare.terms import By, Terms

SEEDS = 1000
BEGAN = datetime(2026, 1, 5, tzinfo=UTC)
TERMS = Terms(By.BATCH, groups=("batch 0", "batch 1", "batch 2"))


def fleet(rows):
    """Runs of a design, in the order they are made in."""
    return tuple(
        run_of(
            number,
            f"batch {batch}",
            f"station {station}",
            BEGAN + timedelta(hours=number),
            serial=f"S-{sensor:03d}",
            simulated=("figures",),
        )
        for number, (batch, station, sensor) in enumerate(rows)
    )


@pytest.mark.parametrize("title", DESIGNS)
def test_the_batch_is_found_and_the_station_is_not_taken_for_it(title):
    rows = design(DESIGNS[title])
    runs, now = fleet(rows), BEGAN + timedelta(days=365)
    held, found, taken, plainly_held, plainly_found = [], [], [], [], []
    for seed in range(SEEDS):
        (metric,) = compare(table_of(runs, values(rows, seed)), TERMS, now).of_metrics
        for number, one in zip((1, 2), metric.differences, strict=True):
            true = BATCHES[number] - BATCHES[0]
            held.append(one.low <= true <= one.high)
            plainly_held.append(one.naive.low <= true <= one.naive.high)
        differs, alike = metric.differences
        found.append(differs.low > 0)
        plainly_found.append(differs.naive.low > 0)
        taken.append(not alike.low <= 0.0 <= alike.high)
    assert 0.935 <= np.mean(held) <= 0.965
    assert np.mean(found) >= 0.95
    assert np.mean(taken) <= 0.065
    if DESIGNS[title]:  # what stations differ by spreads the last figures of all batches alike
        assert np.mean(plainly_found) < np.mean(found) - 0.02
    else:
        assert np.mean(plainly_held) < 0.92
