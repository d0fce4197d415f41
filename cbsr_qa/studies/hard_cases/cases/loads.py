"""Hard cases of load and force estimates: symmetric places, electrodes, extreme sizes."""

from functools import lru_cache
from typing import Any, Final

import mpmath
import numpy as np

from cbsr_qa.calibration.force.inverse import ForceInverse, map_tables
from cbsr_qa.calibration.force.template_matching import Matches, TemplateFilter
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.errors import CalibrationError, NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.load_estimates import LoadEstimate
from cbsr_qa.domain.results.calibration import ForceModel, Lattice
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic
from cbsr_qa.eit.estimate.load_estimate import LoadEstimator
from cbsr_qa.eit.estimate.readings import MergedReadings, load_model, merge_reciprocal
from cbsr_qa.eit.loads.round_load import RoundLoadModel, RoundLoads
from cbsr_qa.studies.hard_cases.case import Answer, Area, answer_from_condition
from cbsr_qa.studies.hard_cases.exact import DIGITS, largest_relative_error, relative_error

AREA: Final = Area("calibration")
_PLACE: Final = "the place it was pressed at"
_USUAL: Final = "place and strength at the usual size"
_STRENGTH: Final = "the strength that was pressed"
_FIFTY: Final = "the formula in fifty digits"
_RADIUS_MM: Final = 6.5
_NOISE: Final = 2.4e-5  # of a reading at unit conductance, as the simulated 8 wt% sensor has it
_LINE: Final = QuasiStatic(Parameter(4.5e-3, 1e-4, "case"), Parameter(-1.1e-3, 1e-4, "case"), 0.0)
_SIDE: Final = 13  # of the lattice of the made-up templates


@lru_cache
def disc() -> tuple[RoundLoadModel, MergedReadings]:
    """Model and readings of the 100 mm disc."""
    sensor_type = load_sensor_type("disc-100mm").value
    pattern = sensor_type.pattern
    return load_model(sensor_type), merge_reciprocal(pattern, pattern.usable(), np.full(pattern.shape, _NOISE**2))


def changes_of(x_mm: float, y_mm: float, contrast: float = 0.1) -> Array:
    """Changes (1, m) of the used readings under one head."""
    model, readings = disc()
    load = RoundLoads.from_contrast(np.array([[x_mm, y_mm]]), np.array([_RADIUS_MM]), np.array([contrast]))
    return model.readings(load).change[:, readings.used]


def estimate_load(changes: Array) -> LoadEstimate:
    """Estimate one load of known size."""
    return LoadEstimator(*disc(), expected_radius_mm=_RADIUS_MM, known=True).estimate(changes)[0]


def locate_head(x_mm: float) -> Answer:
    """Where a head without noise is found, on the sheet's axis."""
    changes = changes_of(x_mm, 0.0)
    estimate = estimate_load(changes)
    if estimate.place_mm is None or estimate.place_covariance_mm2 is None:
        return Answer(float("inf"), 0.0)
    error = float(np.hypot(estimate.place_mm[0] - x_mm, estimate.place_mm[1]))
    # The place moves by its standard error per unit of a row, and rows round by their size.
    rows = disc()[1].merge_changes(changes)
    condition = float(np.sqrt(np.trace(estimate.place_covariance_mm2)) * np.linalg.norm(rows))
    return answer_from_condition(error, condition, unit="mm")


def nothing_found(changes: Array, why: str) -> Answer:
    """Loads found in a frame that holds none, or another reason given than there is."""
    estimate = estimate_load(changes)
    right = estimate.place_mm is None and why in estimate.why
    return Answer(0.0 if right else 1.0, 0.0, unit="wrong statements", note=estimate.why)


def force_model(log_response: float, log_size: float = 0.0) -> ForceModel:
    """Build an even sheet whose templates turn with place, (cos, sin) of x and y over 8 mm."""
    lattice = Lattice((-6.0, -6.0), 1.0, _SIDE, _SIDE)
    x, y = lattice.places_mm().T / 8
    count = _SIDE**2
    templates = np.column_stack([np.cos(x), np.sin(x), np.cos(y), np.sin(y)]) / np.sqrt(2)
    zeros, metric_entry = np.zeros(count), np.full(count, 1 / 128)
    return ForceModel(
        lattice,
        np.arange(count).reshape(_SIDE, _SIDE),
        np.eye(4),
        templates,
        np.full(count, log_size),
        np.zeros((count, 4)),
        np.zeros((count, 2)),
        np.column_stack([metric_entry, zeros, metric_entry]),
        np.ones(count, dtype=np.bool_),
        np.full(count, log_response),
        np.full(count, 0.01),
        0.01,
        (5.0, 40.0),
        6.0,
        0.1,
        0.0,
        0.0,
    )


def newtons(strength: float, log_response: float) -> tuple[float, float]:
    """Force and standard error [N] of a strength at the middle of an even sheet."""
    model = force_model(log_response)
    inverse = ForceInverse(model, _LINE, 132.7, map_tables(model))
    nothing = np.zeros(1)
    match = Matches(np.zeros((1, 2)), np.array([strength]), 1e-6 * np.eye(3)[None], nothing, nothing)
    force, stderr = inverse.force(match)
    return float(force[0]), float(stderr[0])


def force_of(strength: float, log_response: float) -> Answer:
    """Force against σ = (κ/S − β)/α, F = σ A in fifty digits."""
    force, stderr = newtons(strength, log_response)
    with mpmath.workdps(DIGITS):
        a, area = mpmath.mpf(strength), mpmath.mpf(132.7) / 1000
        sheet_response = 2 * a / (2 - a) * mpmath.exp(-mpmath.mpf(log_response))
        beta, alpha = mpmath.mpf(_LINE.intercept.value), mpmath.mpf(_LINE.slope.value)
        truth = (sheet_response - beta) / alpha * area
        condition = float(
            (abs(sheet_response) * (1 + abs(log_response) + 2 / (2 - a)) + abs(beta)) / abs(sheet_response - beta)
        )
    error = relative_error(force, truth) if np.isfinite(stderr) and stderr > 0 else 1.0
    return answer_from_condition(error, condition)


def match_scaled_templates(size: float) -> Answer:
    """Place and strength from templates scaled by a factor, against unscaled ones."""
    model = force_model(0.0)
    finder = TemplateFilter(model)
    places = np.array([[0.0, 0.0], [1.3, -2.2], [-2.4, 0.7]])
    rows = finder.template(places)
    usual, other = finder.search(rows), finder.search(size * rows)
    away = np.abs(usual.place_mm - other.place_mm).max() / 8
    error = max(float(away), largest_relative_error(other.strength / size, usual.strength.tolist()))
    return answer_from_condition(error, 1.0)


def match_sized_templates(log_size: float) -> Answer:
    """Strength of a head whose templates are this large."""
    finder = TemplateFilter(force_model(0.0, log_size))
    place = np.array([2.0, -1.0])
    match = finder.match_at(0.1 * finder.template(place[None]), place)
    condition = 1 + abs(log_size)
    return answer_from_condition(relative_error(float(match.strength[0]), mpmath.mpf(0.1)), condition)


@AREA.against(_PLACE)
def load_at_the_exact_centre() -> Answer:
    """A head in the middle of the sheet, where all mirror images fall together."""
    return locate_head(0.0)


@AREA.against(_PLACE)
def load_a_picometre_off_the_centre() -> Answer:
    """A head 1e-9 mm off the middle."""
    return locate_head(1e-9)


@AREA.refuses(NumericsError)
def load_on_an_electrode() -> None:
    """A head whose centre is on a pin, where the field has a pole instead of a power series."""
    changes_of(47.9, 0.0)


@AREA.against("no load")
def frame_without_any_change() -> Answer:
    """A frame without any change: every place explains it as well as every other."""
    return nothing_found(0 * changes_of(0.0, 0.0), "no load stands out")


@AREA.against("no load, although readings change")
def changes_no_load_makes() -> Answer:
    """Readings that change a million times as much as under any load."""
    return nothing_found(1e6 * changes_of(10.0, 0.0), "the sheet is not what the sensor type describes")


@AREA.against("rows have a variance of one")
def noise_twelve_powers_of_ten_apart() -> Answer:
    """Readings whose noise differs by 1e12, merged with their reciprocal ones."""
    pattern = load_sensor_type("disc-100mm").value.pattern
    variance = 10.0 ** np.linspace(-24.0, 0, pattern.shape[0] * pattern.shape[1]).reshape(pattern.shape)
    readings = merge_reciprocal(pattern, pattern.usable(), variance)
    merged = (readings.merging**2 * variance[readings.used]).sum(axis=1)
    return answer_from_condition(largest_relative_error(merged, [mpmath.mpf(1)] * len(merged)), 1.0)


@AREA.against(_USUAL)
def frames_of_1e_12_standard_errors() -> Answer:
    """Frames of a head at 1e-12 of their noise."""
    return match_scaled_templates(2.0**-40)


@AREA.against(_USUAL)
def frames_of_1e12_standard_errors() -> Answer:
    """Frames of a head at 1e12 times their noise."""
    return match_scaled_templates(2.0**40)


@AREA.against(_STRENGTH)
def templates_of_1e_12() -> Answer:
    """A sensor that responds with 1e-12 of a standard error."""
    return match_sized_templates(-12 * float(np.log(10)))


@AREA.against(_STRENGTH)
def templates_of_1e12() -> Answer:
    """A sensor that responds with 1e12 standard errors."""
    return match_sized_templates(12 * float(np.log(10)))


@AREA.refuses(CalibrationError)
def nowhere_to_press() -> None:
    """A sheet on which the head fits nowhere: no place to search."""
    model: Any = force_model(0.0)
    object.__setattr__(model, "fits", np.zeros(_SIDE**2, dtype=np.bool_))
    TemplateFilter(model)


@AREA.against(_FIFTY)
def force_of_no_change() -> Answer:
    """A strength of zero leaves the line's intercept."""
    return force_of(0.0, 0.0)


@AREA.against(_FIFTY)
def force_where_the_response_is_1e_13() -> Answer:
    """A place with 1e-13 of the expected response: a division by almost zero."""
    return force_of(0.05, -30.0)


@AREA.against(_FIFTY)
def force_where_the_response_is_1e13() -> Answer:
    """A place with 1e13 times the expected response."""
    return force_of(0.05, 30.0)


@AREA.against("monotonic and finite")
def strengths_no_contrast_has() -> Answer:
    """κ = 2a/(2 − a) has a pole at a strength of 2, and is negative beyond."""
    forces = np.array([newtons(strength, 0.0) for strength in (1.0, 1.9, 2.0, 2.5, 1e12)])
    wrong_count = int((~np.isfinite(forces)).sum()) + int((np.diff(forces[:, 0]) < 0).sum())
    return Answer(float(wrong_count), 0.0, unit="wrong statements")
