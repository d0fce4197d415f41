"""Hard cases of a batch's model: nothing in common, everything in common, presses that coincide."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from mpmath import mp

from cbsr_qa.calibration.batch.likelihood import BatchLikelihood, Hyperparameters
from cbsr_qa.calibration.batch.loads import ROUNDING, BatchLoads, SensorLoads, correlate_places
from cbsr_qa.calibration.batch.model import learn_batch
from cbsr_qa.calibration.batch.prior import BatchPrior
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.studies.hard_cases.case import Answer, Area, answer_from_condition
from cbsr_qa.studies.hard_cases.exact import DIGITS, largest_relative_error

AREA: Final = Area("batch")
_REGRESSION: Final = "regression on the loads of all sensors in fifty digits"
_NINE: Final[Array] = np.array(NINE_LOCATIONS_MM)
_THERE_MM: Final[Array] = np.array([[3.0, -4.0], [20.0, 25.0]])
_USUAL: Final = Hyperparameters(False, 20.0, 0.01, 0.1, 0.15, 0.03)
_SENSORS: Final = 5
_RADIUS_MM: Final = 50.0


def press(places_mm: Array, number: int, variance: float = 1e-4) -> SensorLoads:
    """Loads of one sensor: a wave over the sheet, which all have, and one of its own."""
    common, own = np.sin(places_mm[:, 0] / 20), np.cos(places_mm[:, 1] / 15 + number)
    return SensorLoads(places_mm, 0.15 * common + 0.05 * own, np.full(len(places_mm), variance))


def predict(choice: Hyperparameters, sensors: Sequence[SensorLoads]) -> Answer:
    """Map of the last sensor by its own loads and the others', of one choice of the hyperparameters."""
    prior = BatchPrior(BatchLikelihood(BatchLoads(sensors[:-1])), [choice], [1.0])
    computed = np.concatenate(prior.learn_response(sensors[-1]).predict(_THERE_MM))
    covariance, values = _covary_loads(choice, sensors), [sensor.log_response for sensor in sensors]
    condition = float(np.linalg.cond(covariance[: -len(_THERE_MM), : -len(_THERE_MM)]))
    exact = _regress(_exact_covariance(choice, sensors), np.concatenate(values))
    return answer_from_condition(largest_relative_error(computed, exact), condition)


def _covary_loads(choice: Hyperparameters, sensors: Sequence[SensorLoads]) -> Array:
    return np.array([[float(entry) for entry in row] for row in _exact_covariance(choice, sensors)])


def _exact_covariance(choice: Hyperparameters, sensors: Sequence[SensorLoads]) -> list[list[Any]]:
    """Covariance of all loads, and of the last sensor's map at the places asked for; correlations are in doubles."""
    every = np.concatenate([*(sensor.places_mm for sensor in sensors), _THERE_MM])
    counts = [len(sensor.variance) for sensor in sensors]
    of = np.repeat(np.arange(len(sensors)), [*counts[:-1], counts[-1] + len(_THERE_MM)])
    alike = correlate_places(every, every, choice.length_mm, choice.smooth)
    noise = [*np.concatenate([sensor.variance for sensor in sensors]).tolist(), *[None] * len(_THERE_MM)]
    with mp.workdps(DIGITS):
        common, own, level = mp.mpf(choice.common) ** 2, mp.mpf(choice.own) ** 2, mp.mpf(choice.level) ** 2
        rows = [
            [common * entry + (own * entry + level if of[i] == of[j] else 0) for j, entry in enumerate(row)]
            for i, row in enumerate(alike.tolist())
        ]
        for k, variance in enumerate(noise):
            if variance is not None:
                rows[k][k] += mp.mpf(variance) + mp.mpf(choice.scatter) ** 2 + mp.mpf(ROUNDING)
    return rows


def _regress(covariance: list[list[Any]], values: Array) -> list[Any]:
    """Means and variances at the last places, the level unknown."""
    count, asked = len(values), len(_THERE_MM)
    with mp.workdps(DIGITS):
        seen: Any = mp.matrix([row[:count] for row in covariance[:count]])
        columns = [mp.matrix(values.tolist()), mp.matrix([1] * count)]
        columns += [mp.matrix([covariance[i][count + k] for i in range(count)]) for k in range(asked)]
        solved = [mp.cholesky_solve(seen, column) for column in columns]
        precision = mp.fsum(solved[1])
        level = mp.fsum(solved[0]) / precision
        means, variances = [], []
        for k in range(asked):
            left = 1 - mp.fsum(solved[2 + k])
            means.append(level * left + mp.fdot(columns[2 + k], solved[0]))
            explained = mp.fdot(columns[2 + k], solved[2 + k])
            variances.append(covariance[count + k][count + k] - explained + left**2 / precision)
    return [*means, *variances]


@AREA.against(_REGRESSION)
def sensors_with_nothing_in_common() -> Answer:
    """A share in common of 4e-15: the common map is far below the rounding of the sensors' own."""
    return predict(replace(_USUAL, common=_USUAL.own * 6e-8), [press(_NINE[:4], k) for k in range(_SENSORS)])


@AREA.against(_REGRESSION)
def sensors_with_everything_in_common() -> Answer:
    """A share in common of 1 − 4e-13: own maps far below the noise of a press."""
    return predict(replace(_USUAL, own=1e-7, level=0.0), [press(_NINE[:4], k) for k in range(_SENSORS)])


@AREA.against(_REGRESSION)
def sensors_that_are_one() -> Answer:
    """The same loads without noise from five sensors with neither own maps nor levels: one covariance five times."""
    choice = replace(_USUAL, own=0.0, level=0.0, scatter=0.0)
    return predict(choice, [press(_NINE[:4], 0, 0.0) for _ in range(_SENSORS)])


@AREA.against(_REGRESSION)
def presses_of_sensors_a_picometre_apart() -> Answer:
    """Each sensor is pressed 1e-9 mm beside the one before: places of the batch that all but coincide."""
    return predict(_USUAL, [press(_NINE[:4] + 1e-9 * k, k) for k in range(_SENSORS)])


@AREA.against(_REGRESSION)
def presses_within_a_tenth_of_a_millimetre() -> Answer:
    """All presses lie within a five-hundredth of a smooth map's length: its covariance has one direction."""
    choice = replace(_USUAL, smooth=True, length_mm=70.0)
    return predict(choice, [press(_NINE[:4] / 300, k) for k in range(_SENSORS)])


@AREA.against(_REGRESSION)
def one_place_pressed_fifty_times() -> Answer:
    """One sensor of the batch is pressed fifty times at one place, the others once each at four."""
    repeated = press(np.repeat(_NINE[:1], 50, axis=0), 0)
    return predict(_USUAL, [repeated, *(press(_NINE[:4], k) for k in range(1, _SENSORS))])


@AREA.against(_REGRESSION)
def a_sensor_known_a_million_times_better() -> Answer:
    """Presses of one sensor have a variance 1e10 below the others'."""
    sensors = [press(_NINE[:4], k, 1e-14 if k == 0 else 1e-4) for k in range(_SENSORS)]
    return predict(replace(_USUAL, scatter=0.0), sensors)


@AREA.against("an interval that ends at one")
def share_of_five_identical_sensors() -> Answer:
    """Five sensors with the same loads: the likelihood never falls as ρ approaches one."""
    found = learn_batch([press(_NINE, 0)] * _SENSORS, radius_mm=_RADIUS_MM).rho
    return Answer(1 - found.high, 0.0, note=f"from {found.low:.4f}")


@AREA.against("an interval that begins at zero")
def share_of_sensors_that_are_opposite() -> Answer:
    """Sensors whose maps add up to nothing: they are less alike than independent ones, which no ρ describes."""
    signs = (1.0, -1.0, 1.0, -1.0, 1.0, -1.0)
    loads = [replace(press(_NINE, 0), log_response=sign * press(_NINE, 0).log_response) for sign in signs]
    found = learn_batch(loads, radius_mm=_RADIUS_MM).rho
    return Answer(found.low, 0.0, note=f"to {found.high:.2f}")


@AREA.refuses(CalibrationError)
def batch_with_nan() -> None:
    """A press of one sensor whose response is NaN."""
    SensorLoads(_NINE, np.full(9, np.nan), np.zeros(9))
