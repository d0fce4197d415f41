"""Sweeps of station time: ways to calibrate, and their results.

Long runs are simulated once per seed; cheaper ways with fewer presses or shorter holds reuse their stored frames.
Other ways (shorter rests, other frame times) are simulated separately.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from cbsr_qa.analysis.run import farthest_first
from cbsr_qa.domain import CbsrError, finite_numbers
from cbsr_qa.domain.results import RunObservation
from cbsr_qa.domain.run import LoadRecord, RunRecord
from cbsr_qa.studies.frontier.sensors import analysis_of, observed, simulated_sensor
from cbsr_qa.studies.frontier.setting import FARTHEST, GRID, HELD_OUT, LEAST_SURE, SUNFLOWER, Setting, held_out_phase
from cbsr_qa.studies.frontier.trial import errors_of, grid_places, least_sure_first, only

#: Random loads to test a simulated sensor, unknown to all settings.
TEST_LOADS: Final = 30

SEEDS: Final = tuple(range(2001, 2005))
QUICK_SEEDS: Final = (2001,)

#: The paper's campaign: nine locations, six strains, three trials, a minute on and a minute off.
PAPER: Final = Setting(9, (5.0, 10.0, 15.0, 20.0, 25.0, 30.0), 3)
#: Thirty places at one strain, held as long; fewer in the quick sweep.
EVEN: Final = Setting(30)
QUICK_EVEN: Final = Setting(16)


@dataclass(frozen=True, slots=True)
class Tried:
    """A setting on one sensor: its errors by name (:data:`.trial.UNITS`), or why nothing could be learned."""

    series: str
    setting: Setting
    seed: int
    errors: Mapping[str, float]
    why: str = ""

    def __post_init__(self) -> None:
        finite_numbers(list(self.errors.values()), "errors")


def subsets_of_paper(*, quick: bool) -> list[tuple[str, Setting]]:
    """Parts of the paper's campaign, beginning with the whole."""
    strains = (PAPER.strains_percent, (10.0, 20.0, 30.0), (20.0,))
    trials = (3, 1)
    every = [
        ("strains and trials", replace(PAPER, strains_percent=some, trials=count))
        for count in trials
        for some in strains
    ]
    return [every[0], every[-1]] if quick else every


def subsets_of_even(*, quick: bool) -> list[tuple[str, Setting]]:
    """Parts of thirty places (fewer in the quick sweep) held for a minute, beginning with the whole."""
    if quick:
        short = [replace(QUICK_EVEN, hold_s=15.0, predicted=predicted) for predicted in (False, True)]
        return [("hold", setting) for setting in (QUICK_EVEN, *short)]
    holds = [
        ("hold", replace(EVEN, hold_s=hold_s, predicted=predicted))
        for hold_s in (30.0, 20.0, 15.0, 10.0)
        for predicted in (False, True)
    ]
    frames = [("frames averaged", replace(EVEN, steady_frames=count)) for count in (1, 2, 8)]
    return [("hold", EVEN), *holds, ("frames averaged", EVEN), *frames]


def choices_of_even() -> list[tuple[str, Setting]]:
    """Ways to choose fewer of the thirty places."""
    return [
        ("choice of places", replace(EVEN, places=count, choice=choice))
        for count in (9, 12, 18)
        for choice in (FARTHEST, LEAST_SURE)
    ]


def simulated_alone(*, quick: bool) -> list[tuple[str, Setting]]:
    """Ways with other rests or frame times; one of them belongs to several series, and is simulated once."""
    short = Setting(16, hold_s=15.0, rest_s=5.0, predicted=True)
    rests = [("rest", replace(short, rest_s=rest_s)) for rest_s in (5.0, 15.0, 30.0)]
    places = [("places", replace(short, places=count)) for count in (9, 12, 16, 20, 26)]
    hold = [("places", replace(short, places=19, hold_s=10.0))]
    averaging = [("frame time", replace(short, frame_period_s=period_s)) for period_s in (1.25, 2.5, 5.0)]
    return [rests[0]] if quick else [*rests, *places, *hold, *averaging]


def tried_on_paper(seed: int, *, quick: bool) -> list[Tried]:
    """Simulate the paper's campaign on one sensor, and try it and its parts."""
    run = _Simulated(PAPER, seed, whole_holds=False)
    return [
        run.tried(series, setting, run.strains_and_trials(setting))
        for series, setting in subsets_of_paper(quick=quick)
    ]


def tried_on_even(seed: int, *, quick: bool) -> list[Tried]:
    """Simulate thirty places (16 in the quick sweep) on one sensor, and try them and shorter holds."""
    run = _Simulated(QUICK_EVEN if quick else EVEN, seed)
    settings = subsets_of_even(quick=quick) + ([] if quick else choices_of_even())
    return [run.tried(series, setting) for series, setting in settings]


def tried_alone(seed: int, series: Sequence[str], setting: Setting) -> list[Tried]:
    """Simulate one way on one sensor, for every series it belongs to."""
    tried = _Simulated(setting, seed).tried(series[0], setting)
    return [replace(tried, series=name) for name in series]


class _Simulated:
    """One sensor after a setting's recipe and thirty more random loads held for a minute."""

    def __init__(self, setting: Setting, seed: int, *, whole_holds: bool = True) -> None:
        self._seed = seed
        recipe = setting.recipe()
        recipe["phases"].append(held_out_phase(TEST_LOADS))
        self._sensor = simulated_sensor(recipe, seed, setting.frame_period_s, whole_holds)
        run = observed(self._sensor.record, analysis_of(recipe))
        own = only(run, lambda load: load.phase != HELD_OUT)
        self._seen = {(setting.hold_s, setting.steady_frames): own}
        self._held_out = only(run, lambda load: load.phase == HELD_OUT)

    def strains_and_trials(self, setting: Setting) -> Callable[[LoadRecord], bool]:
        """Select the grid's loads of a setting with fewer strains or trials."""
        strains = [percent / 100 for percent in setting.strains_percent]
        return lambda load: load.load.trial < setting.trials and bool(np.isclose(load.load.strain, strains).any())

    def _chosen(self, setting: Setting) -> Callable[[LoadRecord], bool]:
        """Select the grid's loads of a setting with fewer places."""
        run = self._observed(setting)
        if setting.choice == LEAST_SURE:
            numbers = set(least_sure_first(run, setting.places))
        else:
            numbers = set(farthest_first(grid_places(run), setting.places))
        return lambda load: load.index in numbers

    def tried(self, series: str, setting: Setting, wanted: Callable[[LoadRecord], bool] = lambda load: True) -> Tried:
        try:
            chosen = wanted if setting.choice == SUNFLOWER else self._chosen(setting)
            own = only(self._observed(setting), lambda load: load.phase != GRID or chosen(load.record))
            errors = errors_of(own, self._held_out, self._sensor.design)
        except CbsrError as refusal:
            return Tried(series, setting, self._seed, {}, refusal.reason)
        return Tried(series, setting, self._seed, errors)

    def _observed(self, setting: Setting) -> RunObservation:
        """The loads of the run as a setting would have held and averaged them."""
        key = (setting.hold_s, setting.steady_frames)
        analysis = analysis_of(setting.recipe())
        if key not in self._seen:
            run = observed(shortened(self._sensor.record, setting.hold_s), analysis)
            self._seen[key] = only(run, lambda load: load.phase != HELD_OUT)
        return replace(self._seen[key], settings=analysis)


def shortened(record: RunRecord, hold_s: float) -> RunRecord:
    """Return a run with the grid's holds cut to a shorter time."""

    def shortened_load(load: LoadRecord) -> LoadRecord:
        early_s = load.release_start_s - (load.hold_start_s + hold_s)
        if early_s <= 0:
            return load
        return replace(
            load,
            release_start_s=load.release_start_s - early_s,
            release_end_s=load.release_end_s - early_s,
            clear_s=None if load.clear_s is None else load.clear_s - early_s,
        )

    phases = tuple(
        replace(phase, loads=tuple(map(shortened_load, phase.loads))) if phase.name == GRID else phase
        for phase in record.phases
    )
    return replace(record, phases=phases)


def station_work(*, quick: bool) -> Iterator[tuple[str, str, Callable[[], list[Tried]]]]:
    """Yield simulations, longest first: key, description, function."""
    seeds: Sequence[int] = QUICK_SEEDS if quick else SEEDS
    mode = "quick" if quick else "full"
    for seed in seeds:
        if not quick:
            paper = partial(tried_on_paper, seed, quick=quick)
            yield f"paper/{mode}/{seed}", f"the paper's campaign, sensor {seed}", paper
        even = partial(tried_on_even, seed, quick=quick)
        yield f"even/{mode}/{seed}", f"places held for a minute, sensor {seed}", even
    alone: dict[Setting, list[str]] = {}
    for series, setting in simulated_alone(quick=quick):
        alone.setdefault(setting, []).append(series)
    for setting, names in alone.items():
        what = ", ".join(f"{name} {value}" for name, value in setting.knobs.items())
        for seed in seeds:
            run = partial(tried_alone, seed, tuple(names), setting)
            key = f"alone/{'+'.join(names)}/{what}/{seed}"
            yield key, f"{names[0]}: {setting.places} places, sensor {seed}", run
