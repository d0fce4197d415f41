"""What a place costs in presses and in time: learned from presses of two real skins, or of a simulated sheet.

``python -m benchmarks pressed_places`` prints the table of docs/explanation/place.md. Presses are split at random,
anew for every trial; 800 others are located (fewer where there are fewer).
"""

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.rows import Row
from cbsr_qa.calibration.place import PlaceEstimator
from cbsr_qa.calibration.presses import learn_presses

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "samples"))

from pressed_sheets import Pressed, pressed_sheet, skin, some

TITLE = "Places learned from presses"
_SKINS = Path("../shared/data/skins")
_LOCATED = 800
#: Presses, trials, and the mean error [mm] to reach on each skin.
GOALS = {
    "no_pattern": {9: (50, 5.6), 39: (50, 3.5), 100: (20, 2.4), 400: (20, 1.7), 1600: (20, 1.25)},
    "parallel_lines": {9: (50, 17.0), 39: (50, 5.5), 100: (20, 3.5), 400: (20, 2.2), 1600: (20, 1.6)},
}
_LONGEST_MS = 5.0
Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class Trial:
    """One split: mean error [mm], coverage of 68 and 95 % regions, seconds of learning, milliseconds of a frame."""

    error_mm: float
    coverage: tuple[float, float]
    in_model: float
    learned_s: float
    frame_ms: float


def rows() -> Iterator[Row]:
    """Few trials of every number of presses; all of them take hours (``make soak``)."""
    sheets = {name: skin(_SKINS, name) for name in GOALS if _SKINS.exists()}
    sheets["simulated"] = pressed_sheet(1200, noise=0.1, rectified=True)
    for name, sheet in sheets.items():
        for count in (9, 39, 100, 400):
            goal = GOALS.get(name, {}).get(count)
            yield _row(name, count, [trial(sheet, count, seed) for seed in range(3)], goal)


def trial(sheet: Pressed, count: int, seed: int) -> Trial:
    """Learn from ``count`` presses drawn at random and locate others."""
    order = np.random.default_rng([seed, count]).permutation(len(sheet.labels_mm))
    return tried(sheet, order[_LOCATED : _LOCATED + count], order[:_LOCATED])


def tried(sheet: Pressed, learned: Numbers, located: Numbers) -> Trial:
    """Learn from some presses as ``cbsr-qa calibrate`` does, and locate others."""
    begin = time.perf_counter()
    locate = PlaceEstimator(learn_presses(some(sheet, learned).labelled()).place.model)
    learned_s = time.perf_counter() - begin
    begin = time.perf_counter()
    for frame in sheet.changes[located[:20], None]:
        locate(frame)
    frame_ms = 1e3 * (time.perf_counter() - begin) / 20
    places = locate(sheet.changes[located])
    error = sheet.labels_mm[located] - places.place_mm
    ratio = np.einsum("na,na->n", error, np.linalg.solve(places.covariance_mm2, error[:, :, None])[:, :, 0])
    coverage = float((ratio <= locate.q68).mean()), float((ratio <= locate.q95).mean())
    distance = float(np.linalg.norm(error, axis=1).mean())
    return Trial(distance, coverage, float(places.in_model.mean()), learned_s, frame_ms)


def _row(name: str, count: int, trials: list[Trial], goal: tuple[int, float] | None) -> Row:
    error, low, high, taken, learned, frame = (
        float(np.mean([np.atleast_1d(getattr(trial, column))[which] for trial in trials]))
        for column, which in (
            ("error_mm", 0), ("coverage", 0), ("coverage", 1), ("in_model", 0), ("learned_s", 0), ("frame_ms", 0),
        )
    )  # fmt: skip
    here = f"{error:.2f} mm, regions of 68 and 95 % hold {low:.0%} and {high:.0%}, {taken:.0%} taken for touches;"
    here += f" learned in {learned:.1f} s, {frame:.1f} ms a frame"
    met = None if goal is None else error <= goal[1] and frame <= _LONGEST_MS
    wanted = "" if goal is None else f"≤ {goal[1]:g} mm, ≤ {_LONGEST_MS:g} ms a frame"
    return Row(f"{name.replace('_', ' ')}, {count} presses", wanted, here, "", met)
