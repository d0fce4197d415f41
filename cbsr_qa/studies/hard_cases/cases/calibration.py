"""Hard cases of calibration: line fits, response maps, registration, loads in readings."""

from typing import Final

import mpmath
import numpy as np

from cbsr_qa.calibration.fits.quasi_static import fit_quasi_static
from cbsr_qa.calibration.fits.relaxation_kernel import learn_kernel
from cbsr_qa.calibration.force.sheet_pose import sheet_pose_of
from cbsr_qa.calibration.force.template_matching import Matches
from cbsr_qa.calibration.sheet.baseline import predict_change
from cbsr_qa.calibration.sheet.characteristic import sheet_gauge_factor
from cbsr_qa.calibration.sheet.response_map import ResponseMap, learn_response
from cbsr_qa.domain.errors import CalibrationError, NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic
from cbsr_qa.eit.imaging.registration import register
from cbsr_qa.studies.hard_cases.case import Answer, Area, answer_from_condition
from cbsr_qa.studies.hard_cases.exact import (
    exact_line,
    exact_map,
    largest_relative_error,
    line_condition,
    map_condition,
    relative_error,
)

AREA: Final = Area("calibration")
_SQUARES: Final = "weighted least squares of the same numbers in fifty digits"
_MIXTURE: Final = "the same mixture of Gaussian processes in fifty digits, load by load"
_TURN: Final = "the rotation and scale they were made with"
_KERNEL: Final = "the kernel the traces were made from"
_STRAINS: Final[Array] = np.array([0.05, 0.10, 0.15, 0.20, 0.25, 0.30])
NINE: Final[Array] = np.array(NINE_LOCATIONS_MM)
_SEED: Final = 20261121
_LEAST_VARIANCE: Final = 1e-12  # of a load in a map of the response
_PROCESSES: Final = 12  # of a map, that are held against truth: fifty digits take their time


def line(x: Array, change: Array, stderr: Array | None = None) -> Answer:
    """Slope of a line through loads at six strains, against weighted least squares in fifty digits."""
    stderr_list = None if stderr is None else stderr.tolist()
    fit = fit_quasi_static(_STRAINS.tolist(), x.tolist(), change.tolist(), stderr_list)
    weighted = x, change, np.ones_like(x) if stderr is None else stderr
    return answer_from_condition(relative_error(fit.slope, exact_line(*weighted)[0]), line_condition(*weighted))


def response(places_mm: Array, log_response: Array, variance: Array) -> Answer:
    """Response predicted between loads by some of the processes, and how they are weighed against each other."""
    query_places_mm = np.array([[3.0, -4.0], [45.0, 0.0]])
    learned = learn_response(places_mm, log_response, variance, radius_mm=50.0)
    selected = np.linspace(0, len(learned.weights) - 1, _PROCESSES).astype(int)
    weights = learned.weights[selected] / learned.weights[selected].sum()
    partial_map = ResponseMap(learned.places_mm, tuple(learned.members[k] for k in selected), weights)
    mean, spread = partial_map.predict(query_places_mm)
    exact_mean, exact_spread = exact_map(partial_map, places_mm, log_response, variance, query_places_mm)
    error = max(largest_relative_error(mean, exact_mean), largest_relative_error(spread, exact_spread))
    condition = map_condition(partial_map, places_mm, variance)
    return answer_from_condition(error, condition, note=f"{_PROCESSES} of {len(learned.weights)} processes compared")


def _wavy(places_mm: Array, variance: Array) -> Answer:
    """A map of a response that waves over the sheet."""
    return response(places_mm, 0.1 * np.sin(places_mm[:, 0] / 20) + 0.05 * np.cos(places_mm[:, 1] / 15), variance)


def kernel(unit: float, sizes: tuple[float, ...], *, releases: bool = False) -> Answer:
    """Weights and time constants learned from exact holds (or releases) of these sizes, in this unit."""
    time_s: Array = 2.5 * np.arange(25.0)
    relaxing = 0.3 * np.exp(-time_s / 5) + 0.2 * np.exp(-time_s / 30)
    traces = [(time_s, unit * (size * relaxing + (0.01 if releases else size))) for size in sizes]
    learned = learn_kernel(traces, released=[unit * size for size in sizes] if releases else None)
    values = [*learned.weights, *learned.time_constants_s]
    error = largest_relative_error(values, [0.3, 0.2, 5.0, 30.0]) if len(values) == 4 else 1.0
    return Answer(error, 1e-9, note="exact but for a prior and a noise of 1e-6 of a load")


def sheet_pose(seen_mm: Array, shift_mm: float) -> Answer:
    """Fitted displacement of a sheet."""
    nothing = np.zeros(len(seen_mm))
    covariance = np.tile(np.diag([1e-4, 1e-2, 1e-2]), (len(seen_mm), 1, 1))
    pose = sheet_pose_of(NINE, Matches(seen_mm, nothing + 0.1, covariance, nothing, nothing), nothing + 1)
    moved = float(np.abs(pose.places_mm(NINE) - NINE - shift_mm).max())
    return answer_from_condition(moved if np.isfinite(pose.shift_stderr_mm) else 1.0, 60.0, unit="mm")


@AREA.against(_SQUARES)
def stresses_of_1e6_with_a_tiny_spread() -> Answer:
    """A line through stresses that differ by a hundred-millionth of themselves: sums of squares keep none of it."""
    return line(1e6 + 0.1 * _STRAINS, 0.6 * _STRAINS)


@AREA.against(_SQUARES)
def weights_twenty_four_powers_of_ten_apart() -> Answer:
    """One strain is known 1e12 times better than the others."""
    return line(100 * _STRAINS, 0.6 * _STRAINS + 0.01 * np.cos(40 * _STRAINS), np.array([1, 1, 1e-12, 1, 1, 1]))


@AREA.against("slope and intercept zero, with a finite error")
def material_that_does_not_answer() -> Answer:
    """Changes that are zero at every load: no scatter and no size to take an error from."""
    fit = fit_quasi_static(_STRAINS.tolist(), _STRAINS.tolist(), [0.0] * 6)
    error = abs(fit.slope) + abs(fit.intercept)
    return Answer(error if np.isfinite(fit.covariance).all() else 1.0, 0.0, unit="relative conductance change")


@AREA.against("σ/√n, that of a mean of six")
def error_of_a_line_far_from_zero() -> Answer:
    """The error in the middle of the loads, from those of slope and intercept 1e5 spreads away, which cancel."""
    middle, spread = 1e5, 1.0
    x = middle + spread * (_STRAINS - _STRAINS.mean()) / _STRAINS.std()
    fit = fit_quasi_static(_STRAINS.tolist(), x.tolist(), (0.001 * x).tolist(), [0.01] * 6)
    _, error = predict_change(fit.as_parameters("case"), middle)
    condition = 2 * (middle / spread) ** 2  # of the terms that cancel to their sum
    return answer_from_condition(relative_error(error, mpmath.mpf(0.01) / mpmath.sqrt(6)), condition)


@AREA.refuses(NumericsError)
def one_strain() -> None:
    """Loads at a single strain determine a slope or an intercept, not both."""
    fit_quasi_static([0.1] * 3, [10.0, 10.1, 9.9], [0.06, 0.061, 0.059])


@AREA.refuses(NumericsError)
def collinear_design() -> None:
    """Six strains, all at one stress: the two columns of the line are parallel."""
    fit_quasi_static(_STRAINS.tolist(), [0.1 * 3] * 6, _STRAINS.tolist())


@AREA.refuses(CalibrationError)
def line_at_its_zero() -> None:
    """α ε + β is zero at the loads: their response is a division by zero."""
    nothing = QuasiStatic(Parameter(0.6, 0.01, "case"), Parameter(-0.06, 0.01, "case"), 0.0)
    places, strain = NINE, np.full(9, 0.1)
    sheet_gauge_factor(places, np.full(9, 0.05), np.full(9, 1e-4), strain, nothing, radius_mm=50.0, sheet_mm=places)


@AREA.against(_MIXTURE)
def loads_a_picometre_apart() -> Answer:
    """Places that differ by 1e-9 mm, without noise: rows of the covariance that are equal to twenty digits."""
    return _wavy(np.vstack([NINE[:4], NINE[:3] + 1e-9]), np.zeros(7))


@AREA.against(_MIXTURE)
def loads_in_a_tenth_of_a_millimetre() -> Answer:
    """All loads within a thousandth of the shortest length: the covariance has one direction and rounding."""
    return _wavy(NINE[:7] / 300, np.zeros(7))


@AREA.against(_MIXTURE)
def loads_known_a_million_times_better() -> Answer:
    """Loads whose variances differ by 1e12."""
    return _wavy(NINE[:7], 10.0 ** np.linspace(-14, -2, 7))


@AREA.against("their common value")
def a_hundred_loads_in_a_nanometre() -> Answer:
    """A covariance of a hundred loads that all are one, without noise."""
    places = 1e-6 * np.random.default_rng(_SEED).standard_normal((100, 2))
    mean, variance = learn_response(places, np.full(100, 0.3), np.zeros(100), radius_mm=50.0).predict(places[:3])
    error = largest_relative_error(mean, [mpmath.mpf(0.3)] * 3) if (variance >= 0).all() else 1.0
    return answer_from_condition(error, 1 / _LEAST_VARIANCE)


@AREA.refuses(CalibrationError)
def map_with_nan() -> None:
    """A load whose response is NaN."""
    learn_response(NINE, np.full(9, np.nan), np.zeros(9), radius_mm=50.0)


@AREA.against(_TURN)
def registration_far_from_the_origin() -> Answer:
    """Places with an origin ten kilometres away, on two sides."""
    offset_mm = 1e7
    turn = 1.02 * np.exp(0.1j)
    p = NINE[:, 0] + 1j * NINE[:, 1]
    q = turn * p
    near_places = np.column_stack([p.real, p.imag]) + offset_mm
    far_places = np.column_stack([q.real, q.imag]) - 3 * offset_mm
    registered = register(near_places, far_places)
    error = max(relative_error(registered.scale, mpmath.mpf("1.02")), abs(np.radians(registered.rotation_deg) - 0.1))
    condition = 3 * offset_mm / float(np.abs(p).max())
    return answer_from_condition(float(error), condition)


@AREA.against(_TURN)
def registration_of_places_in_a_line() -> Answer:
    """Places in a line determine the sheet's pose along and across it, but not a mirror image."""
    row = NINE[[0, 1, 2]]
    registered = register(row, np.column_stack([-row[:, 1], row[:, 0]]) * 0.9)
    error = max(relative_error(registered.scale, mpmath.mpf("0.9")), abs(registered.rotation_deg / 90 - 1))
    return answer_from_condition(float(error), 1.0)


@AREA.against("the sheet's pose is unchanged")
def seat_of_a_mirror_image() -> Answer:
    """Loads found in the order of a mirror image: no rigid motion of the sheet explains them."""
    return sheet_pose(NINE * [1.0, -1.0], 0.0)


@AREA.against("a millimetre along both axes")
def seat_without_scatter() -> Answer:
    """Loads all found exactly a millimetre off: a standard error of zero to divide by."""
    return sheet_pose(NINE + 1.0, 1.0)


@AREA.refuses(NumericsError)
def registration_of_one_place() -> None:
    """Nine loads at one place, which rounds to places that differ."""
    register(np.full((9, 2), 1e9 + 0.1), NINE)


@AREA.refuses(NumericsError)
def registration_of_a_mirror_image() -> None:
    """An upside-down sheet: least squares find a scale near zero, and no place where it was pressed."""
    register(NINE, NINE * [1.0, -1.0])


@AREA.against(_KERNEL)
def kernel_of_values_of_1e100() -> Answer:
    """Relaxations in a unit that makes their numbers huge: covariances of 1e200, determinants that overflow."""
    return kernel(1e100, (0.9, 1.0, 1.1))


@AREA.against(_KERNEL)
def kernel_of_loads_a_million_apart() -> Answer:
    """One load is a million times as large as another."""
    return kernel(1.0, (1e-3, 1.0, 1e3))


@AREA.against(_KERNEL)
def kernel_of_releases_of_both_signs() -> Answer:
    """Releases whose changes sum to zero: their mean relaxation is a division by zero."""
    return kernel(1.0, (1.0, -1.0, 2.0, -2.0), releases=True)
