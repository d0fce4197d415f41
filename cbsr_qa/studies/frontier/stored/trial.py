"""One stored run with fewer places and shorter holds: the force errors of its calibration at loads it has not seen.

The run's own frames are analysed again, so that noise, drift and relaxation are those of the station. Loads that do
not calibrate (random ones) are the test, and determine the relaxation that short holds are predicted with.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from cbsr_qa.analysis.run.fewer_places import farthest_first
from cbsr_qa.analysis.run.force import force_tests, learn_without_tests
from cbsr_qa.analysis.run.observe import observe_run
from cbsr_qa.calibration.sheet.response_map import FEWEST
from cbsr_qa.config.merging import restore
from cbsr_qa.domain.errors import CbsrError, RefusedError
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.plan.batch_model import KeptBatch
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.loads import LoadRecord
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.run.run import PhaseRecord, RunRecord
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import Reconstruction
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.frontier.point import Knob
from cbsr_qa.studies.frontier.station import shorten_holds
from cbsr_qa.studies.frontier.trial import select_loads

#: Fewest loads that test a calibration.
FEWEST_TESTS: Final = 3
#: Shares of the places that are tried, and holds [s].
_SHARES: Final = (0.25, 0.35, 0.5, 0.7)
_HOLDS_S: Final = (30.0, 15.0)

Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Way:
    """A run with fewer places or shorter holds.

    Parameters
    ----------
    places : number, the farthest from each other of those pressed.
    hold_s : time that each was held.
    predicted : whether the holds are extrapolated to the end of long ones.
    prior : what is known of the map before the first press: ``"none"``, or ``"batch"``, what the others of its batch
        have in common.
    """

    places: int
    hold_s: float
    predicted: bool
    prior: str = "none"

    @property
    def knobs(self) -> dict[str, Knob]:
        """Settings, for tables and documents."""
        transients = "predicted" if self.predicted else "averaged"
        return {"places": self.places, "hold_s": self.hold_s, "transients": transients, "prior": self.prior}


@dataclass(frozen=True, slots=True)
class StoredTrial:
    """A way on one stored run.

    Parameters
    ----------
    force_error_N : root mean square over the test loads, their places known; None with the reason ``why``.
    station_s : time of the run without what the way leaves out.
    """

    serial: str
    run: str
    way: Way
    force_error_N: float | None
    station_s: float
    why: str = ""


@dataclass(frozen=True, slots=True)
class Design:
    """What a run pressed to calibrate.

    Parameters
    ----------
    places_mm : in the order they were pressed.
    hold_s, predicted : time that each was held, and whether transients were predicted.
    longest_s : longest hold of the run, which relaxation can be predicted to.
    """

    places_mm: tuple[Place, ...]
    hold_s: float
    predicted: bool
    longest_s: float

    @property
    def whole(self) -> Way:
        """The run as it was, without a batch."""
        return Way(len(self.places_mm), self.hold_s, self.predicted)

    def list_ways(self) -> list[Way]:
        """Ways to try without a batch, beginning with the run as it was."""
        whole = self.whole
        counts = sorted({round(share * whole.places) for share in _SHARES}, reverse=True)
        fewer = [count for count in counts if FEWEST <= count < whole.places]
        shorter = [hold_s for hold_s in _HOLDS_S if hold_s < 0.75 * self.hold_s]
        holds = [self.hold_s, *shorter] if self.hold_s < 0.75 * self.longest_s else shorter
        ways = [
            whole,
            *(replace(whole, places=count) for count in fewer),
            *(replace(whole, hold_s=hold_s, predicted=False) for hold_s in shorter),
            *(Way(count, hold_s, predicted=True) for hold_s in holds for count in (whole.places, *fewer)),
        ]
        return list(dict.fromkeys(ways))

    def list_batch_ways(self) -> list[Way]:
        """Ways to try with the batch as prior: those whose loads were held, or are predicted to be, for as long."""
        whole = self.whole
        alike = [way for way in self.list_ways() if way.hold_s == whole.hold_s or way.predicted]
        return [replace(way, prior="batch") for way in alike]

    def choose_places(self, count: int) -> tuple[Place, ...]:
        """The places that a number keeps, in the order they were pressed."""
        kept = farthest_first(np.array(self.places_mm), count)
        return tuple(self.places_mm[k] for k in sorted(kept))


def read_design(record: RunRecord, settings: AnalysisSettings) -> Design:
    """Return what a run pressed to calibrate.

    Raises
    ------
    RefusedError
        If it has too few places, or too few random loads to test a calibration.
    """
    phases = list_calibrating_phases(record, settings)
    loads = [load for phase in phases for load in phase.loads]
    places = tuple(dict.fromkeys((load.load.x_mm, load.load.y_mm) for load in loads))
    tests = sum(len(phase.loads) for phase in record.phases if is_test(phase, settings))
    if len(places) <= FEWEST or tests < FEWEST_TESTS:
        raise RefusedError(
            f"run {record.identity.run} has {len(places)} places and {tests} random loads; to leave some out and test"
            f" the rest takes more than {FEWEST} places and {FEWEST_TESTS} random loads",
            remedy="choose runs of a recipe such as nine-locations or campaign",
        )
    hold_s = round(float(np.median([measure_hold_s(load) for load in loads])), 1)
    longest_s = round(max(measure_hold_s(load) for phase in record.phases for load in phase.loads), 1)
    return Design(places, hold_s, settings.transients == "predicted", longest_s)


def list_calibrating_phases(record: RunRecord, settings: AnalysisSettings) -> list[PhaseRecord]:
    """Return the phases whose loads calibrate."""
    return [phase for phase in record.phases if phase.name in settings.calibrate_phases and phase.loads]


def is_test(phase: PhaseRecord, settings: AnalysisSettings) -> bool:
    """Whether the loads of a phase test a calibration."""
    return phase.role is Role.RANDOM and phase.name not in settings.calibrate_phases


def try_stored_run(url: str, run: str, batch: KeptBatch | None = None) -> list[StoredTrial]:
    """Load a run, and try all ways of its design.

    Parameters
    ----------
    batch : model of the other sensors of its batch, for the ways with it as prior; None for those without.

    Raises
    ------
    StoreError
        If the run cannot be read, or does not match its chain.
    RefusedError
        If its design allows no trial.
    """
    with open_store(url, create=False) as store:
        record = store.runs.load(run)
        recipe = restore(store.runs.read_configuration(run)).recipe
    method: Reconstruction = create_plugin(discover(), Kind.RECONSTRUCTION, recipe.reconstruction, "[reconstruction]")
    return try_ways(record, method, recipe.analysis, batch)


def try_ways(
    record: RunRecord, method: Reconstruction, settings: AnalysisSettings, batch: KeptBatch | None = None
) -> list[StoredTrial]:
    """Try all ways of a run's design on its frames: those with a batch as prior, or without one."""
    settings = replace(settings, prior="none", batch=batch)
    design = read_design(record, settings)
    names = frozenset(phase.name for phase in list_calibrating_phases(record, settings))
    trials = []
    seen: dict[float, RunObservation] = {}
    tests: RunObservation | None = None
    for way in design.list_ways() if batch is None else design.list_batch_ways():
        try:
            if way.hold_s not in seen:
                shortened = shorten_holds(record, way.hold_s, names)
                seen[way.hold_s] = observe_run(shortened, method, settings, over_time=False)
            run = seen[way.hold_s]
            tests = tests or select_loads(run, lambda load: is_test(record.phase(load.phase), settings))
            error_N, why = _measure_error(run, tests, way, design), ""
        except CbsrError as refusal:
            error_N, why = None, refusal.reason
        station_s = record.station_s - measure_left_out_s(record, settings, way, design)
        identity = record.identity
        trials.append(StoredTrial(identity.sensor.serial, identity.run, way, error_N, station_s, why))
    return trials


def _measure_error(run: RunObservation, tests: RunObservation, way: Way, design: Design) -> float:
    """Root mean square of a way's force errors over the test loads [N]."""
    kept = set(design.choose_places(way.places))
    transients = "predicted" if way.predicted else "averaged"
    settings = replace(run.settings, transients=transients, prior=way.prior)
    calibrate = run.settings.calibrate_phases
    chosen = select_loads(run, lambda load: load.phase not in calibrate or load.place_mm in kept)
    force = learn_without_tests(replace(chosen, settings=settings))
    assert force.learned is not None
    errors = [test.known_N - test.measured_N for test in force_tests(tests, force.learned)]
    if len(errors) < FEWEST_TESTS:
        raise RefusedError(f"only {len(errors)} random loads have a force")
    return float(np.sqrt(np.mean(np.square(errors))))


def measure_left_out_s(record: RunRecord, settings: AnalysisSettings, way: Way, design: Design) -> float:
    """Station time that a way leaves out: whole cycles of places, and ends of holds [s].

    Finding the surface is not counted: when it was done, a run does not say.
    """
    kept = set(design.choose_places(way.places))
    total_s = 0.0
    for phase in list_calibrating_phases(record, settings):
        before_s: Sequence[float] = [phase.loads[0].press_start_s, *(load.rest_end_s for load in phase.loads)]
        for load, began_s in zip(phase.loads, before_s, strict=False):
            if (load.load.x_mm, load.load.y_mm) not in kept:
                total_s += load.rest_end_s - began_s
            else:
                total_s += max(measure_hold_s(load) - way.hold_s, 0.0)
    return total_s


def measure_hold_s(load: LoadRecord) -> float:
    """Time that a load was held [s]."""
    return load.release_start_s - load.hold_start_s


def plan_trial(url: str, run: str, batch: KeptBatch | None = None) -> Callable[[], list[StoredTrial]]:
    """Return the work on one run, for any process."""
    return partial(try_stored_run, url, run, batch)
