"""Hard cases of comparisons: huge levels, variances of zero or out of proportion, batches without scatter."""

from collections.abc import Sequence
from math import sqrt
from typing import Final

import mpmath
import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.crossings import crossing
from cbsr_qa.stats.gauge.type1 import study_type1
from cbsr_qa.stats.mixed_model.model import fit
from cbsr_qa.stats.serial_correlation import correlate_successive
from cbsr_qa.stats.stratified import shift_within
from cbsr_qa.studies.compare.models import Fitted, fit_model, include_sessions
from cbsr_qa.studies.hard_cases.case import Answer, Area, answer_from_condition
from cbsr_qa.studies.hard_cases.exact import DIGITS, relative_error

AREA: Final = Area("comparison")
_SEED: Final = 20261129
_BATCHES, _STATIONS, _SENSORS = ("41", "42", "43"), ("A", "B", "C"), 6
#: Runs of a balanced fleet, (batch, station, sensor) of each: every sensor once, on one station.
_RUNS: Final = tuple(
    (batch, station, f"{batch}-{station}-{number}")
    for batch in _BATCHES
    for station in _STATIONS
    for number in range(_SENSORS)
)


def fit_fleet(values: Array) -> Fitted:
    """Fit one metric of the balanced fleet, sessions included where they show."""
    batches, stations, sensors = map(list, zip(*_RUNS, strict=True))
    return include_sessions([fit_model(crossing(batches, stations, sensors), values, "x", of_stations=False)])[0]


def exact_difference(values: Array, group: str, reference: str) -> mpmath.mpf:
    """Return the difference of two batches' means, which every model of a balanced fleet gives, in fifty digits."""
    with mpmath.workdps(DIGITS):
        sums = {batch: mpmath.mpf(0) for batch in _BATCHES}
        for (batch, _, _), value in zip(_RUNS, values.tolist(), strict=True):
            sums[batch] += mpmath.mpf(value)
        return (sums[group] - sums[reference]) / (len(_STATIONS) * _SENSORS)


def draw(session_deviation: float = 0.0, scatter: Sequence[float] = (1.0, 1.0, 1.0)) -> Array:
    """Draw values of the fleet: sensors that scatter by batch, about sessions (a batch at a station)."""
    random = np.random.default_rng(_SEED)
    sessions = session_deviation * random.standard_normal((len(_BATCHES), len(_STATIONS), 1))
    sensors = random.standard_normal((len(_BATCHES), len(_STATIONS), _SENSORS))
    drawn: Array = (sessions + np.array(scatter)[:, None, None] * sensors).ravel()
    return drawn


@AREA.against("the difference of means in fifty digits")
def difference_of_batches_at_a_billion() -> Answer:
    """Values of 1e9 that differ by one: their squares have no digit of the difference."""
    values = 1e9 + draw()
    found = fit_fleet(values).difference("42", "41").value
    truth = exact_difference(values, "42", "41")
    return answer_from_condition(relative_error(found, truth), 2e9 / abs(float(truth)))


@AREA.against("the scatter of session means over stations, by hand")
def sessions_a_million_times_the_sensors() -> Answer:
    """The variance of sessions is 1e12 times that of sensors: the sensors' share of it is lost in rounding."""
    values = draw(session_deviation=1e6)
    difference = fit_fleet(values).difference("42", "41")
    sessions = values.reshape(len(_BATCHES), len(_STATIONS), _SENSORS).mean(axis=2)
    rest = sessions - sessions.mean(axis=0) - sessions.mean(axis=1)[:, None] + sessions.mean()
    variance = float((rest**2).sum()) / ((len(_BATCHES) - 1) * (len(_STATIONS) - 1))
    error = abs(difference.standard_error / sqrt(2 * variance / len(_STATIONS)) - 1)
    return Answer(error, 1e-6, note=f"on {difference.freedom:.3g} degrees of freedom")


@AREA.against("the difference of means in fifty digits")
def sessions_that_do_not_differ() -> Answer:
    """Means of sessions fit batch and station exactly: the variance of sessions is at its bound, zero."""
    values = draw().reshape(len(_BATCHES), len(_STATIONS), _SENSORS)
    values = values - values.mean(axis=2, keepdims=True) + np.arange(3.0)[:, None, None] + np.arange(3.0)[:, None]
    found = fit_fleet(values.ravel()).difference("42", "41").value
    truth = exact_difference(values.ravel(), "42", "41")
    return answer_from_condition(relative_error(found, truth), 10.0)


@AREA.against("the difference of means in fifty digits")
def batch_without_scatter_beside_others() -> Answer:
    """All values of a batch are equal: weighted by its own scatter alone it would weigh infinitely."""
    values = draw(scatter=(1.0, 1.0, 0.0)) + 5.0 * np.repeat([0.0, 0.0, 1.0], len(_STATIONS) * _SENSORS)
    found = fit_fleet(values).difference("43", "41").value
    truth = exact_difference(values, "43", "41")
    return answer_from_condition(relative_error(found, truth), 1e3)


@AREA.refuses(NumericsError)
def one_sensor_a_batch() -> None:
    """Two batches of one sensor each, on two stations: nothing tells batch and sensor apart."""
    design = crossing(["41", "42", "41", "42"], ["A", "A", "B", "B"], ["S1", "S2", "S1", "S2"])
    fit(design, np.array([1.0, 2.0, 3.0, 4.1]), "x")


@AREA.against("the shift of the same values without stations")
def shift_within_stations_at_a_billion() -> Answer:
    """Stations that differ by 1e9 times what batches differ by."""
    random = np.random.default_rng(_SEED)
    strata = [(random.integers(1, 64, 8) / 64 + 1.0, random.integers(0, 64, 8) / 64) for _ in range(3)]
    apart = [(first + 1e9 * number, second + 1e9 * number) for number, (first, second) in enumerate(strata)]
    plain, shifted = shift_within(strata), shift_within(apart)
    return answer_from_condition(abs(shifted.value - plain.value) / abs(plain.value), 2e9 / abs(plain.value))


@AREA.against("the same values about zero")
def correlation_of_neighbours_at_a_billion() -> Answer:
    """Successive values of 1e9 that differ by one."""
    values = np.round(np.cumsum(np.random.default_rng(_SEED).standard_normal(40)) * 64) / 64
    plain, raised = correlate_successive(values), correlate_successive(values + 1e9)
    error = abs(raised.coefficient - plain.coefficient) + abs(raised.p - plain.p)
    return answer_from_condition(error, 1e9)


@AREA.refuses(NumericsError)
def type_1_study_of_readings_that_are_equal() -> None:
    """A resolution coarser than the scatter: Cg would be infinite."""
    study_type1([10.0] * 25, 10.0, 1.0)
