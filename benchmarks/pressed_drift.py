"""Regions of places long after a session, on simulated sheets whose readings drift in eight ways.

``python -m benchmarks.pressed_drift 2`` learns from 400 presses of two sheets for each kind, and locates 400 others
4.25 to 5.25 sessions after the last press (5 s each): figures of docs/explanation/place.md. ``--recheck`` adds nine
presses from just before. Noise is 70 % of the median change; drift makes errors up to twice as large.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.place.estimator import PlaceEstimator
from cbsr_qa.calibration.place.learning import learn_place
from cbsr_qa.calibration.place.mixture import mahalanobis

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "samples"))

from pressed_sheets import pressed_sheet

Array = NDArray[np.float64]
#: Numbers of the presses in the order in which they are made: learned from, tried for a re-check, and located.
_ROWS = np.concatenate([np.arange(400), np.arange(2000, 2500)])
_NOISE, _GAIN, _OFFSET = 0.7, 0.25, 0.5  # the last two: walks in a session, of a logarithm and in median changes
KINDS = (
    "none", "gain of all", "gain of each reading", "offset of each reading", "gain and offset",
    "gain of each electrode", "steady gain", "steady gain and offset", "settling",
)  # fmt: skip


def drift(kind: str, pairs: Array, random: np.random.Generator) -> tuple[Array, Array]:
    """Logarithms of gains and offsets (presses, readings), the latter in median changes."""
    time, readings = _ROWS / 400, len(pairs)
    step = np.sqrt(np.diff(time, prepend=0.0))[:, None]

    def walk(count: int) -> Array:
        return np.cumsum(step * random.standard_normal((len(time), count)), axis=0)

    def slopes() -> Array:
        return random.standard_normal(readings) / np.sqrt(time[-1])

    none, steady, settled = np.zeros((len(time), readings)), time[:, None], 1 - np.exp(-time / 1.5)[:, None]
    electrodes = 0.7 * _GAIN * walk(16)
    return {
        "none": lambda: (none, none),
        "gain of all": lambda: (0.8 * _GAIN * walk(1) + none, none),
        "gain of each reading": lambda: (_GAIN * walk(readings), none),
        "offset of each reading": lambda: (none, _OFFSET * walk(readings)),
        "gain and offset": lambda: (0.7 * _GAIN * walk(readings), 0.7 * _OFFSET * walk(readings)),
        "gain of each electrode": lambda: (electrodes[:, pairs].sum(axis=2) / 2, none),
        "steady gain": lambda: (_GAIN * steady * slopes(), none),
        "steady gain and offset": lambda: (0.7 * _GAIN * steady * slopes(), 0.7 * _OFFSET * steady * slopes()),
        "settling": lambda: (
            1.5 * _GAIN * settled * random.standard_normal(readings),
            1.5 * _OFFSET * settled * random.standard_normal(readings),
        ),
    }[kind]()


def locate(kind: str, seed: int, *, recheck: bool) -> tuple[float, float, float]:
    """Mean error [mm] of late presses, and the shares inside their regions of 68 and 95 %."""
    sheet, random = pressed_sheet(len(_ROWS), seed=seed, noise=_NOISE), np.random.default_rng([seed, 31])
    gain, offset = drift(kind, sheet.pairs, random)
    changes = np.exp(gain) * sheet.changes + np.median(np.abs(sheet.changes)) * offset
    learned, time_s = np.arange(400), None
    if recheck:
        learned = np.append(learned, 400 + np.sort(random.choice(100, 9, replace=False)))
        time_s = 10.0 * _ROWS[learned]
    model = learn_place(changes[learned], sheet.labels_mm[learned], sheet.pairs, 16, time_s=time_s).model
    estimator = PlaceEstimator(model)
    places = estimator(changes[500:])
    error_mm = sheet.labels_mm[500:] - places.place_mm
    ratio = mahalanobis(error_mm, places.covariance_mm2)
    return (
        float(np.linalg.norm(error_mm, axis=1).mean()),
        float((ratio <= estimator.q68).mean()),
        float((ratio <= estimator.q95).mean()),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sheets", type=int)
    parser.add_argument("--recheck", action="store_true")
    asked = parser.parse_args()
    for kind in KINDS:
        trials = np.array([locate(kind, 71 + sheet, recheck=asked.recheck) for sheet in range(asked.sheets)])
        error_mm, low, high = trials.mean(axis=0)
        print(f"| {kind} | {error_mm:.2f} mm | {low:.0%}, {high:.0%} | worst {trials[:, 1].min():.0%} |", flush=True)


if __name__ == "__main__":
    main()
