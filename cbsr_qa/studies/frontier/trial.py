"""One trial of the frontier: a simulated sensor calibrated from some loads, and the errors of its calibration.

Map, gauge factor, settling time and forces are compared. The loads are chosen in advance or one by one: next is the
place where the map learned so far is least certain, or the one farthest from all pressed places. Both ways choose
among the places of a run that pressed them all, to find whether evaluating the loads before choosing pays.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from cbsr_qa.analysis.run.fewer_places import farthest_first
from cbsr_qa.analysis.run.force import force_tests, hold_traces, learn_without_tests
from cbsr_qa.analysis.run.force_quality import gauge_factor
from cbsr_qa.calibration.fits.common_relaxation import common_settling_time, fit_common_relaxation
from cbsr_qa.calibration.force.interpolation import interpolate
from cbsr_qa.calibration.force.learning import LearnedForce
from cbsr_qa.calibration.sheet.response_map import sheet_places
from cbsr_qa.domain.errors import CbsrError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.world import SheetDesign
from cbsr_qa.domain.results.observation import LoadObservation, RunObservation
from cbsr_qa.domain.sensor.sensor_type import Relaxation
from cbsr_qa.studies.frontier.setting import FARTHEST, GRID, LEAST_SURE, RADIUS_MM

#: Share of the steady change within which a hold counts as settled (paper, 4.3).
_TOLERANCE: Final = 0.15
#: Rings and spokes for the mean response under a head.
_RINGS, _SPOKES = 6, 12

#: Errors of a trial relative to truth and their units; in both directions.
UNITS: Final = {
    "force_error": "N",
    "force_error_found": "N",
    "map_error": "1",
    "gauge_factor_error": "1",
    "settling_error": "1",
}


def measure_errors(run: RunObservation, held_out: RunObservation, design: SheetDesign) -> dict[str, float]:
    """Calibrate with a run and return its errors; values that cannot be determined are absent.

    Parameters
    ----------
    run : run with the loads of a setting only.
    held_out : loads of the same sensor outside the setting, held for a minute.
    design : design of the simulated sheet: the truth.

    Returns
    -------
    ``force_error`` and ``force_error_found`` [N]: root mean square over the held-out loads, with the place known and
    estimated; ``map_error`` [1]: root mean square within 40 mm of the map against the true response under the head,
    both over their means; ``gauge_factor_error`` and ``settling_error`` [1]: relative, with their sign.

    Raises
    ------
    CbsrError
        If no force model can be learned.
    """
    force = learn_without_tests(run)
    assert force.learned is not None
    errors = _forces(force.learned, held_out)
    model, material = force.learned.model, run.record.material
    places = sheet_places(model)
    truth = true_response(design, places, run.record.indenter.radius_mm)
    is_near = np.hypot(*places.T) <= RADIUS_MM
    mapped = np.exp(interpolate(model, model.log_response, places[is_near]))
    errors["map_error"] = _rms(mapped / mapped.mean() / (truth[is_near] / truth[is_near].mean()) - 1)
    traces = hold_traces(run, select_long_holds(run))
    with suppress(CbsrError):
        gauge, _ = gauge_factor(run, force, traces=traces)
        errors["gauge_factor_error"] = gauge.value / (material.against_strain.slope.value * float(truth.mean())) - 1
    with suppress(CbsrError):
        window_s = max(float(times[-1]) for times, _ in traces)
        settled, _ = common_settling_time(fit_common_relaxation(traces), window_s=window_s, tolerance=_TOLERANCE)
        if settled.value_s is not None and not settled.censored:
            errors["settling_error"] = settled.value_s / true_settling_s(material.loading_relaxation) - 1
    return {name: value for name, value in errors.items() if np.isfinite(value)}


def select_loads(run: RunObservation, wanted: Callable[[LoadObservation], bool]) -> RunObservation:
    """Return a run with some of its loads."""
    return replace(run, loads=tuple(load for load in run.loads if wanted(load)))


def select_long_holds(run: RunObservation) -> list[LoadObservation]:
    """Select loads that determine the sensor's relaxation: those held longest."""
    hold_times_s = [load.record.release_start_s - load.record.hold_start_s for load in run.loads]
    return [load for load, seconds in zip(run.loads, hold_times_s, strict=True) if seconds >= 0.9 * max(hold_times_s)]


def _forces(learned: LearnedForce, held_out: RunObservation) -> dict[str, float]:
    tests = force_tests(held_out, learned)
    errors_at_known_places = [test.known_N - test.measured_N for test in tests]
    errors_at_found_places = [test.found_N - test.measured_N for test in tests if test.found_N is not None]
    errors = {"force_error": errors_at_known_places, "force_error_found": errors_at_found_places}
    return {name: _rms(values) for name, values in errors.items() if values}


def _rms(values: ArrayLike) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def true_response(design: SheetDesign, places_mm: Array, radius_mm: float) -> Array:
    """Mean response (n,) of a simulated sheet under a round head at places (n, 2)."""
    reach = radius_mm * np.sqrt((np.arange(_RINGS) + 0.5) / _RINGS)
    turn = np.arange(_SPOKES) * 2 * np.pi / _SPOKES
    about = np.stack([np.outer(reach, np.cos(turn)), np.outer(reach, np.sin(turn))], axis=-1).reshape(-1, 2)
    mean: Array = np.mean([design.response_at(places_mm + step) for step in about], axis=0)
    return mean


def true_settling_s(relaxation: Relaxation) -> float:
    """Time until the remaining part of a step response is 15 % of the steady change [s]."""

    def residual_change(time_s: float) -> float:
        terms = zip(relaxation.weights, relaxation.time_constants_s, strict=True)
        return abs(sum(float(weight * np.exp(-time_s / tau)) for weight, tau in terms)) - _TOLERANCE

    return float(brentq(residual_change, 0.0, 100 * max(relaxation.time_constants_s)))


#: Places pressed before the first map, and places chosen at a time afterwards.
FIRST: Final = 6
_AT_A_TIME: Final = 3
#: Least distance between places chosen together: a press determines its neighbourhood too.
_APART_MM: Final = 15.0


def choose_least_sure(run: RunObservation, count: int) -> list[int]:
    """Choose places of a run's grid, each where the map learned so far is least certain.

    Returns
    -------
    Indices of the grid's loads, in the order of pressing.

    Raises
    ------
    CbsrError
        If no map can be learned from the first loads.
    """
    places = list_grid_places(run)
    chosen = farthest_first(places, min(FIRST, count))
    while len(chosen) < count:
        force = learn_without_tests(select_loads(run, lambda load: load.phase != GRID or load.record.index in chosen))
        assert force.learned is not None
        _, variance = force.learned.response.predict(places)
        chosen.extend(_choose_least_certain(places, variance, chosen, min(_AT_A_TIME, count - len(chosen))))
    return chosen


def _choose_least_certain(places: Array, variance: Array, chosen: Sequence[int], count: int) -> list[int]:
    """The least certain places, apart from each other, or closer if there are no others."""
    new_places: list[int] = []
    for apart_mm in (_APART_MM, 0.0):
        for k in np.argsort(-variance).tolist():
            is_taken = k in chosen or k in new_places
            near = any(np.hypot(*(places[k] - places[other])) < apart_mm for other in new_places)
            if len(new_places) < count and not is_taken and not near:
                new_places.append(k)
    return new_places


def farthest(run: RunObservation, count: int) -> list[int]:
    """Choose places of a run's grid, each as far as possible from those before it; indices of its loads."""
    return farthest_first(list_grid_places(run), count)


def list_grid_places(run: RunObservation) -> Array:
    """Places (n, 2) of the grid's loads, in order."""
    loads = [load.record.load for load in run.loads if load.phase == GRID]
    return np.array([(load.x_mm, load.y_mm) for load in loads]).reshape(-1, 2)


#: Ways to choose fewer places than a run pressed.
CHOICES: Final = {FARTHEST: farthest, LEAST_SURE: choose_least_sure}
