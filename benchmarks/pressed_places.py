"""What a place costs in presses and in time: learned from presses of two real skins, or of a simulated sheet.

``python -m benchmarks pressed_places`` prints the table of docs/explanation/place.md. Presses are split at random,
anew for every trial; 800 others are located (fewer where there are fewer).
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.rows import Row
from cbsr_qa.studies.frontier.presses.trial import Trial, try_presses

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "samples"))

from pressed_sheets import Pressed, pressed_sheet, skin

TITLE = "Places learned from presses"
_SKINS = Path("../shared/data/skins")
_LOCATED = 800
#: Presses, trials, and the mean error [mm] to reach on each skin.
GOALS = {
    "no_pattern": {9: (50, 5.6), 39: (50, 3.5), 100: (20, 2.4), 400: (20, 1.7), 1600: (20, 1.25)},
    "parallel_lines": {9: (50, 17.0), 39: (50, 5.5), 100: (20, 3.5), 400: (20, 2.2), 1600: (20, 1.6)},
}
_LONGEST_MS = 5.0
#: Draws of nine presses: they differ most.
_DRAWS_OF_NINE = 20


def rows() -> Iterator[Row]:
    """Few trials of every number of presses; all of them take hours (``make soak``)."""
    sheets = {name: skin(_SKINS, name) for name in GOALS if _SKINS.exists()}
    sheets["simulated"] = pressed_sheet(1200, noise=0.1, rectified=True)
    for name, sheet in sheets.items():
        for count in (9, 39, 100, 400):
            goal = GOALS.get(name, {}).get(count)
            yield _row(
                name, count, [split(sheet, count, seed) for seed in range(_DRAWS_OF_NINE if count == 9 else 3)], goal
            )


def split(sheet: Pressed, count: int, seed: int) -> Trial:
    """Learn from ``count`` presses drawn at random and locate others."""
    order = np.random.default_rng([seed, count]).permutation(len(sheet.labels_mm))
    return try_presses(sheet.labelled(), order[_LOCATED : _LOCATED + count], order[:_LOCATED])


def _row(name: str, count: int, trials: list[Trial], goal: tuple[int, float] | None) -> Row:
    error, taken, learned, frame = (
        float(np.mean([getattr(each, column) for each in trials]))
        for column in ("error_mm", "in_model", "learning_s", "frame_s")
    )
    low, high = np.mean([each.inside.mean(axis=0) for each in trials], axis=0)
    single = [float(each.inside[:, 0].mean()) for each in trials]
    here = f"{error:.2f} mm, regions of 68 and 95 % hold {low:.0%} and {high:.0%} (those of 68 % {min(single):.0%} to"
    here += f" {max(single):.0%} in single draws), {taken:.0%} taken for touches;"
    here += f" learned in {learned:.1f} s, {1e3 * frame:.1f} ms a frame"
    met = None if goal is None else error <= goal[1] and 1e3 * frame <= _LONGEST_MS
    wanted = "" if goal is None else f"≤ {goal[1]:g} mm, ≤ {_LONGEST_MS:g} ms a frame"
    return Row(f"{name.replace('_', ' ')}, {count} presses", wanted, here, "", met)
