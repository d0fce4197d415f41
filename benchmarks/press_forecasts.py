"""Presses that a target needs, as ``cbsr-qa frontier --recording`` forecasts them, where the truth is known.

``python -m benchmarks.press_forecasts`` simulates recordings whose errors of place follow laws with and without a
floor, and counts how often the limits hold (ten minutes). ``--skins`` forecasts
what 900 presses of two real skins reach, from recordings of 500 presses of which at most 400 teach (half an hour).
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.presses.inputs import LabelledPresses
from cbsr_qa.studies.frontier.presses.law import fit_laws
from cbsr_qa.studies.frontier.presses.needed import forecast_presses
from cbsr_qa.studies.frontier.presses.resampling import resample_errors
from cbsr_qa.studies.frontier.presses.study import draw_rows, list_numbers
from cbsr_qa.studies.frontier.presses.trial import Trial, try_presses
from cbsr_qa.studies.frontier.recommend import Needed

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "samples"))

from pressed_sheets import skin

Array = NDArray[np.float64]
_SKINS = Path("../shared/data/skins")
#: Scatter of the errors that draws of one press would have, as on the real skins; and of presses' own difficulty.
_DRAWS, _PRESSES = 0.58, 0.5
#: Presses that a target needs, relative to the largest number that is tried; and a target relative to the floor.
FACTORS = (1.5, 3.0, 6.0)
_BELOW = 0.85
#: Errors below which a law has no floor.
_NO_FLOOR_MM = 0.1
ANSWERS = ("limits", "at least", "never", "not known")


@dataclass(frozen=True)
class Judged:
    """Kind of a forecast's answer, and whether it is right; to say that nothing is known always is."""

    answer: str
    right: bool


@dataclass(frozen=True)
class Law:
    """Mean error [mm] after n presses, and standard deviation of labels along each axis [mm]."""

    name: str
    error_mm: Callable[[float], float]
    label_mm: float = 0.0


LAWS = (
    Law("12 n^−0.3", lambda n: 12 * n**-0.3),
    Law("15 n^−0.5", lambda n: 15 * n**-0.5),
    Law("√((15 n^−0.5)² + 1²)", lambda n: float(np.hypot(15 * n**-0.5, 1.0))),
    Law("15 n^−0.5 + 1", lambda n: 15 * n**-0.5 + 1.0),
    Law("15 n^−0.5, labels 0.5 mm", lambda n: 15 * n**-0.5, 0.5),
    Law("12 n^−0.3, labels 2 mm", lambda n: 12 * n**-0.3, 2.0),
    Law("15 n^−0.5, labels 2 mm", lambda n: 15 * n**-0.5, 2.0),
)
#: Presses of a recording, and whether the sweep is the quick one.
RECORDINGS = ((120, False), (500, False), (500, True), (1500, False))


def simulate_trials(law: Law, total: int, quick: bool, seed: int) -> dict[int, list[Trial]]:
    """Draws of a recording: every press teaches something else, is located by another error, has its own label."""
    random = np.random.default_rng([*b"press forecasts", total, quick, seed])
    taught = _DRAWS * random.standard_normal(total)
    difficulty = _draw_difficulties(random, total)
    labels_mm = law.label_mm * random.standard_normal((total, 2))
    trials: dict[int, list[Trial]] = {}
    for learned, located in draw_rows(np.arange(total), quick=quick):
        size = law.error_mm(len(learned)) * np.exp(taught[learned].mean() - _DRAWS**2 / 2 / len(learned))
        spread = size / np.sqrt(np.pi / 2) * difficulty[located, None]
        error = np.hypot(*(spread * random.standard_normal((len(located), 2)) + labels_mm[located]).T)
        none = np.ones(len(located), bool)
        trials.setdefault(len(learned), []).append(Trial(located, error, none[:, None], none, 1.0, 1e-3))
    return trials


def true_error(law: Law, number: float) -> float:
    """Mean error [mm] against labels, over presses of all difficulties."""
    difficulty = _draw_difficulties(np.random.default_rng([*b"difficulties"]), 20000)
    spread = law.error_mm(number) / np.sqrt(np.pi / 2) * difficulty
    return float(np.sqrt(np.pi / 2) * np.hypot(spread, law.label_mm).mean())


def _draw_difficulties(random: np.random.Generator, count: int) -> Array:
    return np.asarray(np.exp(_PRESSES * random.standard_normal(count) - _PRESSES**2 / 2), dtype=np.float64)


def judge(law: Law, total: int, quick: bool, recordings: int) -> Iterator[tuple[str, list[Judged]]]:
    """Yield each target, and how the forecasts of all recordings stand against the presses that it really needs."""
    largest = list_numbers(total)[-1]
    targets_mm = {f"{factor:g} times": (true_error(law, factor * largest), factor * largest) for factor in FACTORS}
    if (floor_mm := true_error(law, 1e15)) > _NO_FLOOR_MM:
        targets_mm["below the floor"] = (_BELOW * floor_mm, np.inf)
    curves = [
        resample_errors(simulate_trials(law, total, quick, seed), np.arange(total)) for seed in range(recordings)
    ]
    for name, (target_mm, number) in targets_mm.items():
        yield name, [judge_one(forecast_presses(curve, target_mm)[0], number) for curve in curves]


def judge_one(needed: Needed | None, number: float) -> Judged:
    """Compare one forecast with the presses that the target really needs; infinite if none reaches it."""
    if needed is None:
        return Judged("not known", True)
    if needed.reachable is False:
        return Judged("never", bool(np.isinf(number)))
    low, high = needed.low or 0, np.inf if needed.high is None else needed.high
    return Judged("at least" if needed.high is None else "limits", low <= number <= high)


def table(recordings: int) -> Iterator[str]:
    """Yield the rows of the table, all laws together; least is that of the law with the fewest right answers."""
    yield "| presses | target needs | right (least) | limits stated | they hold | at least | never | not known |"
    yield f"|{' --- |' * 8}"
    for total, quick in RECORDINGS:
        answers: dict[str, list[list[Judged]]] = {}
        for law in LAWS:
            for name, judged in judge(law, total, quick, recordings):
                answers.setdefault(name, []).append(judged)
        for name, by_law in answers.items():
            every = [one for judged in by_law for one in judged]
            least = min(np.mean([one.right for one in judged]) for judged in by_law)
            share = {what: np.mean([one.answer == what for one in every]) for what in ANSWERS}
            hold = [one.right for one in every if one.answer == "limits"]
            yield (
                f"| {total}{', quick' if quick else ''} | {name} | {_percent(np.mean([one.right for one in every]))}"
                f" ({_percent(least)}) | {_percent(share['limits'])} | {_percent(np.mean(hold)) if hold else '–'} |"
                f" {_percent(share['at least'])} | {_percent(share['never'])} | {_percent(share['not known'])} |"
            )


def _percent(share: float | np.floating) -> str:
    return f"{100 * share:.1f} %"


@dataclass(frozen=True)
class SkinForecast:
    """Mean error [mm] that 900 presses reach, limits of its forecast from up to 400, and the presses for it."""

    quick: bool
    reached_mm: float
    limits_mm: tuple[float, float]
    words: str


def forecast_skin(labelled: LabelledPresses) -> Iterator[SkinForecast]:
    """Yield forecasts from recordings of 500 presses of a skin."""
    total = len(labelled.presses.place_mm)
    reached_mm = []
    for seed in (1, 2, 3):
        order = np.random.default_rng([seed, 77]).permutation(total)
        reached_mm.append(float(try_presses(labelled, order[800:1700], order[:800]).error_mm.mean()))
    for seed, quick in ((1, True), (2, True), (1, False)):
        recording = labelled.select(np.sort(np.random.default_rng([seed, 78]).permutation(total)[:500]))
        trials: dict[int, list[Trial]] = {}
        for learned, located in draw_rows(np.arange(500), quick=quick):
            trials.setdefault(len(learned), []).append(try_presses(recording, learned, located))
        curve = resample_errors(trials, np.arange(500))
        laws = None if curve is None else fit_laws(curve)
        low, _, high = (0.0, np.nan, np.inf) if laws is None else laws.forecast_error(900)
        reach = float(np.mean(reached_mm))
        yield SkinForecast(quick, reach, (low, high), forecast_presses(curve, reach)[1])


def list_skins() -> Iterator[str]:
    """Yield one line per forecast of both skins."""
    for name in ("no_pattern", "parallel_lines"):
        for each in forecast_skin(skin(_SKINS, name).labelled()):
            limits = f"forecast are {each.limits_mm[0]:.2f} to {each.limits_mm[1]:.2f} mm"
            sweep = ", quick" if each.quick else ""
            yield f"{name}{sweep}: 900 presses reach {each.reached_mm:.2f} mm; {limits}; {each.words}"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.press_forecasts", description=__doc__)
    parser.add_argument("--recordings", type=int, default=200, help="simulated recordings of each kind")
    parser.add_argument("--skins", action="store_true", help="forecast the real skins instead")
    given = parser.parse_args()
    for line in list_skins() if given.skins else table(given.recordings):
        print(line, flush=True)


if __name__ == "__main__":
    main()
