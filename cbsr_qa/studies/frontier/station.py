"""Sweeps of station time: ways to calibrate, and their results as points of the frontier.

Long runs are simulated once per seed; cheaper ways with fewer presses or shorter holds reuse their stored frames.
Other ways (shorter rests, other frame times) are simulated separately.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np

import cbsr_qa
from cbsr_qa.domain.errors import CbsrError
from cbsr_qa.domain.numbers import finite_numbers
from cbsr_qa.domain.readings.loads import LoadRecord
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.studies.frontier.point import Accuracy, Point, TimeBasis
from cbsr_qa.studies.frontier.sensors import analyse_run, load_analysis, simulate_sensor
from cbsr_qa.studies.frontier.setting import (
    FARTHEST,
    GRID,
    HELD_OUT,
    LEAST_SURE,
    START,
    SUNFLOWER,
    Setting,
    phase_of_test_loads,
)
from cbsr_qa.studies.frontier.trial import CHOICES, UNITS, measure_errors, select_loads
from cbsr_qa.studies.frontier.worth import mark_worth
from cbsr_qa.studies.sweep import Work

#: Random loads to test a simulated sensor, unknown to all settings.
TEST_LOADS: Final = 30

SEEDS: Final = tuple(range(2001, 2005))
QUICK_SEEDS: Final = (2001,)
#: Sensors that confirm a chosen setting and had no part in the choice.
NEW_SEEDS: Final = tuple(range(3001, 3009))
#: Version of simulation and evaluation: pieces of other versions are computed again.
_VERSION: Final = 4

#: The paper's campaign: nine locations, six strains, three trials, a minute on and a minute off.
PAPER: Final = Setting(9, (5.0, 10.0, 15.0, 20.0, 25.0, 30.0), 3)
#: Places, holds and trials of the shipped recipe ``nine-locations``: part of the paper's campaign.
SHIPPED: Final = replace(PAPER, strains_percent=(20.0,), trials=1)
#: Thirty places at one strain, held as long.
EVEN: Final = Setting(30)
#: Names of settings, for notes and figures.
NAMES: Final = {PAPER: "the paper's campaign", SHIPPED: "the shipped recipe nine-locations"}

#: Settings, each with its series.
Ways = Sequence[tuple[str, Setting]]


@dataclass(frozen=True, slots=True)
class Tried:
    """A setting on one sensor: its errors by name (:data:`.trial.UNITS`), or why nothing could be learned.

    ``sooner_s``: by how much the first rest was shorter than the setting's.
    """

    series: str
    setting: Setting
    seed: int
    errors: Mapping[str, float]
    why: str = ""
    sooner_s: float = 0.0

    def __post_init__(self) -> None:
        finite_numbers(list(self.errors.values()), "errors")


def list_parts_of_paper() -> Ways:
    """Parts of the paper's campaign, beginning with the whole."""
    return [
        ("strains and trials", replace(PAPER, strains_percent=strains, trials=trials))
        for trials in (3, 1)
        for strains in (PAPER.strains_percent, (10.0, 20.0, 30.0), (20.0,))
    ]


def list_parts_of_even() -> Ways:
    """Parts of thirty places held for a minute, beginning with the whole."""
    short = [
        replace(EVEN, hold_s=hold_s, predicted=predicted)
        for hold_s in (30.0, 20.0, 15.0, 10.0)
        for predicted in (False, True)
    ]
    frames = [("frames averaged", replace(EVEN, steady_frames=count)) for count in (4, 1, 2, 8)]
    return [*(("hold", setting) for setting in (EVEN, *short)), *frames]


def list_choices_of_even() -> Ways:
    """Ways to choose fewer of the thirty places."""
    return [
        ("choice of places", replace(EVEN, places=count, choice=choice))
        for count in (9, 12, 18)
        for choice in (FARTHEST, LEAST_SURE)
    ]


#: A setting of many presses in little time.
_SHORT: Final = Setting(16, hold_s=15.0, rest_s=5.0, predicted=True)


def list_simulated_ways() -> Ways:
    """Ways with other rests or frame times; one of them belongs to several series."""
    rests = [("rest", replace(_SHORT, rest_s=rest_s)) for rest_s in (5.0, 15.0, 30.0)]
    places = [("places", replace(_SHORT, places=count)) for count in (9, 12, 16, 20, 26)]
    hold = [("places", replace(_SHORT, places=19, hold_s=10.0))]
    averaging = [("frame time", replace(_SHORT, frame_period_s=period_s)) for period_s in (1.25, 2.5, 5.0)]
    return [*rests, *places, *hold, *averaging, *list_ways_per_press()]


def list_ways_per_press() -> Ways:
    """Ways with less time per press: each saving alone, and all together."""
    savings: list[dict[str, Any]] = [
        {"plane": True},
        {"clearance_mm": 2.0},
        {"rest_s": 30.0, "residue_percent": 1.0},
        {"drift": 0.25},
        {"plane": True, "clearance_mm": 2.0, "residue_percent": 2.0, "drift": 0.25, "few_frames": True},
    ]
    return [("time per press", replace(_SHORT, **saving)) for saving in savings]


def list_quick_ways(places: int) -> Ways:
    """Ways of the quick sweep with short holds, predicted and averaged, beginning with the whole."""
    return [("places", replace(_SHORT, places=places, predicted=predicted)) for predicted in (True, False)]


def plan_station_work(*, quick: bool) -> Iterator[Work]:
    """Yield simulations, longest first, whose results are :class:`Tried`."""
    sweep, seeds = f"station {_VERSION}/{cbsr_qa.__version__}", QUICK_SEEDS if quick else SEEDS
    for seed in seeds:
        # The quick sweep takes up the pieces of the whole one, and the other way round.
        paper = partial(try_ways, PAPER, seed, list_parts_of_paper(), whole_holds=False)
        yield Work(f"{sweep}/paper/full/{seed}", f"the paper's campaign, sensor {seed}", paper)
        if quick:
            for places in (16, 9):
                run = partial(try_ways, replace(_SHORT, places=places), seed, list_quick_ways(places))
                yield Work(f"{sweep}/quick/{places}/{seed}", f"{places} places, sensor {seed}", run)
        else:
            run = partial(try_ways, EVEN, seed, [*list_parts_of_even(), *list_choices_of_even()])
            yield Work(f"{sweep}/even/full/{seed}", f"places held for a minute, sensor {seed}", run)
    if quick:
        return
    series_by_setting: dict[Setting, list[str]] = {}
    for series, setting in list_simulated_ways():
        series_by_setting.setdefault(setting, []).append(series)
    for setting, names in series_by_setting.items():
        for seed in seeds:
            run = partial(try_ways, setting, seed, [(name, setting) for name in names])
            knobs = ", ".join(f"{name} {value}" for name, value in setting.knobs.items())
            key = f"{sweep}/alone/{'+'.join(names)}/{knobs}/{seed}"
            yield Work(key, f"{names[0]}: {setting.places} places, sensor {seed}", run)


def plan_confirming_work(setting: Setting) -> Iterator[Work]:
    """Yield simulations of a chosen setting on sensors that had no part in the choice; results are :class:`Tried`."""
    whole_holds = setting not in {part for _, part in list_parts_of_paper()}
    for seed in NEW_SEEDS:
        run = partial(try_ways, setting, seed, [("new sensors", setting)], whole_holds=whole_holds)
        key = f"station {_VERSION}/{cbsr_qa.__version__}/new/{setting}/{seed}"
        yield Work(key, f"{setting.places} places, new sensor {seed}", run)


def try_ways(whole: Setting, seed: int, ways: Ways, *, whole_holds: bool = True) -> list[Tried]:
    """Simulate a setting on one sensor, and try ways that are parts of it.

    Parameters
    ----------
    whole_holds : False to take only the last frames of the grid's holds, for ways with the same hold.
    """
    run = _Simulated(whole, seed, whole_holds=whole_holds)
    results = {setting: run.errors(setting) for setting in dict.fromkeys(setting for _, setting in ways)}
    return [Tried(series, setting, seed, *results[setting], run.sooner_s) for series, setting in ways]


class _Simulated:
    """One sensor after a setting's recipe and thirty more random loads held for a minute."""

    def __init__(self, setting: Setting, seed: int, *, whole_holds: bool) -> None:
        recipe = setting.recipe()
        recipe["phases"].append(phase_of_test_loads(TEST_LOADS))
        self._record, self._design = simulate_sensor(recipe, seed, setting.frame_period_s, whole_holds)
        run = analyse_run(self._record, load_analysis(recipe))
        self._seen = {(setting.hold_s, setting.steady_frames): select_loads(run, lambda load: load.phase != HELD_OUT)}
        self._held_out = select_loads(run, lambda load: load.phase == HELD_OUT)
        self.sooner_s = 0.0 if setting.drift is None else setting.first_rest_s - measure_settling_s(self._record)

    def errors(self, setting: Setting) -> tuple[Mapping[str, float], str]:
        """Errors of a setting by name, or why nothing could be learned."""
        try:
            run = self._observe(setting)
            chosen = self._load_filter(run, setting)
            setting_run = select_loads(run, lambda load: load.phase != GRID or chosen(load.record))
            return measure_errors(setting_run, self._held_out, self._design), ""
        except CbsrError as refusal:
            return {}, refusal.reason

    @staticmethod
    def _load_filter(run: RunObservation, setting: Setting) -> Callable[[LoadRecord], bool]:
        """Select the grid's loads of a setting with fewer places, strains or trials."""
        if setting.choice != SUNFLOWER:
            places = set(CHOICES[setting.choice](run, setting.places))
            return lambda load: load.index in places
        strains = [percent / 100 for percent in setting.strains_percent]
        return lambda load: load.load.trial < setting.trials and bool(np.isclose(load.load.strain, strains).any())

    def _observe(self, setting: Setting) -> RunObservation:
        """The loads of the run as a setting would have held and averaged them."""
        key = (setting.hold_s, setting.steady_frames)
        analysis = load_analysis(setting.recipe())
        if key not in self._seen:
            run = analyse_run(shorten_holds(self._record, setting.hold_s), analysis)
            self._seen[key] = select_loads(run, lambda load: load.phase != HELD_OUT)
        return replace(self._seen[key], settings=analysis)


def measure_settling_s(record: RunRecord) -> float:
    """Length of a first rest that ended when the sheet was stable: it is filled with frames [s]."""
    start = record.phase(START)
    assert start.frames is not None
    assert start.unloaded_from_s is not None
    times_s = start.frames.time_s
    period_s = float(times_s[1] - times_s[0])
    return float(np.count_nonzero(times_s < start.unloaded_from_s)) * period_s


def shorten_holds(record: RunRecord, hold_s: float, phases: Set[str] = frozenset({GRID})) -> RunRecord:
    """Return a run with the holds of some phases, by default the grid's, cut to a shorter time."""

    def shorten_load(load: LoadRecord) -> LoadRecord:
        early_s = load.release_start_s - (load.hold_start_s + hold_s)
        if early_s <= 0:
            return load
        return replace(
            load,
            release_start_s=load.release_start_s - early_s,
            release_end_s=load.release_end_s - early_s,
            clear_s=None if load.clear_s is None else load.clear_s - early_s,
        )

    shortened = tuple(
        replace(phase, loads=tuple(map(shorten_load, phase.loads))) if phase.name in phases else phase
        for phase in record.phases
    )
    return replace(record, phases=shortened)


def combine_trials(trials: Sequence[Tried], seconds: Callable[[Setting], float]) -> list[tuple[Setting, Point]]:
    """Combine the trials of each setting, with its station time [s], and mark those worth it.

    Values are means over the sensors, of a sensor's root mean square error or of the size of its relative error. A
    setting is worth its time if no other of any series has as small a force error in less time.
    """
    groups: dict[tuple[str, Setting], list[Tried]] = {}
    for tried in trials:
        groups.setdefault((tried.series, tried.setting), []).append(tried)
    points = [
        _point(series, setting, group, seconds(setting) - float(np.mean([tried.sooner_s for tried in group])))
        for (series, setting), group in groups.items()
    ]
    return list(zip((setting for _, setting in groups), mark_worth_of_station(points), strict=True))


def mark_worth_of_station(points: Sequence[Point]) -> list[Point]:
    """Mark which points no other of any series equals in less station time; settings refused on a sensor are not."""
    return mark_worth(points, lambda point: point.station_s, ["force_error"], across_series=True)


def _point(series: str, setting: Setting, group: Sequence[Tried], station_s: float) -> Point:
    refusals = [trial.why for trial in group if trial.why]
    notes = [NAMES[setting]] if setting in NAMES else []
    notes += [f"refused on {len(refusals)} of {len(group)} sensors: {refusals[0]}"] if refusals else []
    accuracy = {}
    for name in () if refusals else UNITS:
        errors = [trial.errors[name] for trial in group if name in trial.errors]
        if len(errors) == len(group):
            accuracy[name] = Accuracy.from_sensors(np.abs(errors).tolist(), UNITS[name])
        elif errors:
            notes.append(f"{name.replace('_', ' ')} not determined on {len(group) - len(errors)} of {len(group)}")
    knobs, note = setting.knobs, "; ".join(notes)
    return Point(TimeBasis.STATION, series, knobs, accuracy, None, station_s, len(group), note)
