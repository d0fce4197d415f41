"""Transient compensation: what a hold cut short costs, with and without the sensor's own relaxations as prior.

``python -m benchmarks steady_state`` prints the table of docs/explanation/transient-compensation.md.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.rows import Row

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "samples"))

from steady_readings import through_readings
from steady_trials import Found, Trial, rms, tried

TITLE = "Transient compensation"
_GOAL = "bias ≤ 3 %, total ≤ 3 %, 68 % intervals cover 64–72 %, 95 % 93–97 %"
_SLOW, _FAST = {"sensors": 100, "held": 20}, {"period_s": 0.25, "sensors": 30, "held": 20}


def rows() -> Iterator[Row]:
    """The cases of the issue first, then what makes them better or worse."""
    for seed, which in ((5001, "seeds of development"), (90210, "held-out seeds")):
        for rate in (_SLOW, _FAST):
            yield _row(f"random places, 20 to 30 % strain; {which}", Trial(seed=seed, **rate), _GOAL)
    for rate in (_SLOW, _FAST):
        yield _row("the centre, 20 % strain", Trial(seed=1, radius_mm=0.0, strains=(0.2, 0.2), **rate))
        yield _row("30 mm from the centre, 20 % strain", Trial(seed=1, radius_mm=30.0, strains=(0.2, 0.2), **rate))
        yield _row("random places, 5 to 10 % strain", Trial(seed=1, strains=(0.05, 0.1), **rate))
        yield _row("loads relax alike", Trial(seed=1, scatter=0.0, **rate))
        yield _row("weights scatter by 5 %", Trial(seed=1, scatter=0.05, **rate))
        yield _row("held for 0.5 of the settling time", Trial(seed=1, share=0.5, **rate))
        yield _row("held for 1.0 of the settling time", Trial(seed=1, share=1.0, **rate))
        yield _row("calibrated with nine loads", Trial(seed=1, loads=9, **rate))
        yield _row("calibrated with one load", Trial(seed=1, loads=1, **rate))
        yield _row("what a release leaves after 60 s", Trial(seed=1, releases=True, **rate))
        yield _row("stress, noise of 1 % of 20 % strain's", Trial(seed=1, signal="stress", **rate))
    yield _said("through the readings of runs (scene base), against the whole hold", 2.5, through_readings(range(8)))


def _row(what: str, trial: Trial, goal: str = "") -> Row:
    return _said(what, trial.period_s, tried(trial), goal)


def _said(what: str, period_s: float, found: Found, goal: str = "") -> Row:
    here = (
        f"{found.frames} frames: bias {100 * found.error.mean():+.2f} %, total {100 * rms(found.error):.2f} %"
        f" (bound {100 * rms(found.bound):.2f} %), coverage {100 * found.cover(0.68):.1f} and"
        f" {100 * found.cover(0.95):.1f} %, median stderr {100 * float(np.median(found.stderr)):.2f} %"
    )
    peer = f"uncompensated: bias {100 * found.uncompensated.mean():+.1f} %"
    peer += f", total {100 * rms(found.uncompensated):.1f} %"
    return Row(f"{1 / period_s:g} frames/s: {what}", goal, here, peer, _met(found) if goal else None)


def _met(found: Found) -> bool:
    honest = 0.64 <= found.cover(0.68) <= 0.72 and 0.93 <= found.cover(0.95) <= 0.97
    return abs(found.error.mean()) <= 0.03 and rms(found.error) <= 0.03 and honest
