"""Error of forces learned from labelled presses of simulated sheets, and coverage of their intervals.

``python -m benchmarks.pressed_forces`` prints the table of docs/explanation/place.md: sheets of 16 electrodes that
answer by 20 % more or less over some 20 mm, pressed with 1 to 5 N, with noise of 10 % of a median change; half of
them have rectifying front ends. Places are found to half a millimetre along each axis (``--learn`` learns them too:
half a minute a sheet). Of each sheet 300 other presses are told. ``--skins`` prints the table of two real skins,
whose readings are multiplied by a force of 1 to 5 N over 3 N: presses at random, and the first of the session, tell
others, at random and its last ones, with and without the search for drift.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cbsr_qa.calibration.place.estimator import PlaceEstimator
from cbsr_qa.calibration.place.learning import PlaceLearned, learn_place
from cbsr_qa.calibration.place.places import Places
from cbsr_qa.calibration.place.quantity import QuantityEstimator, learn_quantity
from cbsr_qa.domain.results.learned_quantity import LearnedQuantity

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "samples"))

from pressed_sheets import Pressed, pressed_sheet, skin

Array = NDArray[np.float64]
_TOLD = 300
_SKINS = Path("../shared/data/skins")
_FOUND_MM = 0.5
_EDGES_N = (1.0, 2.0, 3.0, 4.0, 5.0)


def sheet_of(count: int, seed: int) -> Pressed:
    """A sheet with so many presses to learn from, and those that are told."""
    sheet: Pressed = pressed_sheet(count + _TOLD, seed=seed, noise=0.1, uneven=0.2, rectified=seed % 2 == 1)
    return sheet


def found(sheet: Pressed, seed: int) -> Places:
    """Presses of a sheet beside where they are, as strong as the root mean square of their readings."""
    shift = _FOUND_MM * np.random.default_rng([seed, 1]).standard_normal(sheet.places_mm.shape)
    strength, count = np.sqrt((sheet.changes**2).mean(axis=1)), len(sheet.changes)
    covariance, nothing = np.zeros((count, 2, 2)), np.zeros(count)
    return Places(sheet.places_mm + shift, covariance, nothing, strength, nothing.astype(np.int64))


def errors(count: int, seed: int, *, learn: bool) -> tuple[Array, Array, Array]:
    """Estimated forces of presses, their errors, and whether intervals of 68 and 95 % hold them."""
    sheet = sheet_of(count, seed)
    some, rest = slice(0, count), slice(count, None)
    if learn:
        place = learn_place(sheet.changes[some], sheet.labels_mm[some], sheet.pairs, 16)
        model = _learned(place, sheet.force_N[some], drift=True)
        told = QuantityEstimator(model)(PlaceEstimator(place.model)(sheet.changes[rest]))
    else:
        at = found(sheet, seed)
        model = learn_quantity(sheet.force_N[some], at.strength[some], at.place_mm[some], np.zeros(2))
        parts = (at.place_mm, at.covariance_mm2, at.misfit, at.strength, at.flags)
        told = QuantityEstimator(model)(Places(*(part[rest] for part in parts)))
    truth = sheet.force_N[rest]
    held = [(low <= truth) & (truth <= high) for low, high in (told.within_68.T, told.within_95.T)]
    return truth, told.values - truth, np.array(held)


def skin_rows(name: str, count: int, *, late: bool, draws: int) -> Iterator[str]:
    """Rows of the table of skins: means over draws, with standard errors from their differences."""
    sheet, results = skin(_SKINS, name), []
    for seed in range(draws):
        random = np.random.default_rng([seed, count])
        force_N, order = random.uniform(1.0, 5.0, len(sheet.labels_mm)), random.permutation(len(sheet.labels_mm))
        changes = sheet.changes * force_N[:, None] / 3
        some, rest = np.sort(order[_TOLD : _TOLD + count]), order[:_TOLD]
        if late:
            some, rest = np.arange(count), np.arange(len(force_N) - _TOLD, len(force_N))
        place = learn_place(changes[some], sheet.labels_mm[some], sheet.pairs, 16)
        at, truth = PlaceEstimator(place.model)(changes[rest]), force_N[rest]
        results.append([])
        for drift in (False, True):
            told = QuantityEstimator(_learned(place, force_N[some], drift=drift))(at)
            inside = [((low <= truth) & (truth <= high)).mean() for low, high in (told.within_68.T, told.within_95.T)]
            results[-1].append([np.abs(told.values - truth).mean(), *inside])
    for drift, (means, stderrs) in enumerate(map(_over, zip(*results, strict=True))):
        inside = [
            f"{100 * mean:.0f} ± {100 * stderr:.0f}" for mean, stderr in zip(means[1:], stderrs[1:], strict=True)
        ]
        words = ("the last" if late else "at random", "yes" if drift else "no")
        yield f"| {name} | {count} | {' | '.join(words)} | {means[0]:.3f} ± {stderrs[0]:.3f} | {' | '.join(inside)} |"


def _learned(place: PlaceLearned, force_N: Array, *, drift: bool) -> LearnedQuantity:
    found = place.found
    further = {"session": found.session, "drifts": found.drifts, "visits": found.visits} if drift else {}
    values = force_N[found.presses]
    return learn_quantity(values, found.strength, found.place_mm, place.model.centre_mm, **further)


def row(count: int, sheets: int, *, learn: bool) -> str:
    """One row of the table: means over sheets, with standard errors from their differences."""
    by_force, held = [], []
    for seed in range(sheets):
        truth, error, inside = errors(count, seed, learn=learn)
        bins = np.digitize(truth, _EDGES_N[1:-1])
        by_force.append([np.abs(error[bins == k]).mean() for k in range(len(_EDGES_N) - 1)])
        held.append(inside.mean(axis=1))
    cells = [f"{mean:.3f} ± {stderr:.3f}" for mean, stderr in zip(*_over(by_force), strict=True)]
    cells += [f"{100 * mean:.0f} ± {100 * stderr:.0f}" for mean, stderr in zip(*_over(held), strict=True)]
    return f"| {count} | {sheets} | {' | '.join(cells)} |"


def _over(sheets: Sequence[ArrayLike]) -> tuple[Array, Array]:
    """Means over sheets and their standard errors."""
    values = np.array(sheets)
    return values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(len(values))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pressed_forces", description=__doc__)
    parser.add_argument("--learn", action="store_true", help="learn the places too")
    parser.add_argument("--presses", type=int, nargs="+", default=[20, 39, 100, 400])
    parser.add_argument("--sheets", type=int, default=12)
    parser.add_argument("--skins", action="store_true", help="of two real skins, with known forces")
    chosen = parser.parse_args()
    if chosen.skins:
        print("| skin | presses | told | drift | error [N] | 68 % hold | 95 % hold |\n|" + " --- |" * 7)
        for name in ("no_pattern", "parallel_lines"):
            for count in chosen.presses:
                for late in (False, True):
                    print("\n".join(skin_rows(name, count, late=late, draws=chosen.sheets)), flush=True)
        return
    bins = [f"{low:g} to {high:g} N" for low, high in pairwise(_EDGES_N)]
    print(f"| presses | sheets | {' | '.join(bins)} | 68 % hold | 95 % hold |\n|{' --- |' * (len(bins) + 4)}")
    for count in chosen.presses:
        print(row(count, chosen.sheets, learn=chosen.learn), flush=True)


if __name__ == "__main__":
    main()
