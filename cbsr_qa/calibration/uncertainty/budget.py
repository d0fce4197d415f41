"""Budgets of forces that a calibrated sensor tells (JCGM 100)."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from math import hypot, inf, sqrt
from typing import Final

from cbsr_qa.calibration.force.inverse import NO_FORCE, Flag, Forces
from cbsr_qa.calibration.uncertainty.combination import combine
from cbsr_qa.calibration.uncertainty.force_point import Entry, ForcePoint, ForcePoints
from cbsr_qa.calibration.uncertainty.inputs import ForceInput, ForceInputs
from cbsr_qa.calibration.uncertainty.monte_carlo import simulate_force
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.plan.standards import StandardRole, find_standard
from cbsr_qa.domain.results.calibration import Calibration
from cbsr_qa.domain.results.expanded_force import ExpandedForce, Result

Place = tuple[float, float]
_ROUNDING_MM: Final = 1e-6
_CELL_SCATTER: Final = "scatter of the load cell"
#: Forces with one of these flags are beyond what was calibrated, or no force of one load.
_NO_CLAIM: Final = NO_FORCE | int(
    Flag.NOT_DETECTED | Flag.OUTSIDE | Flag.BELOW_RANGE | Flag.ABOVE_RANGE | Flag.WRONG_SIGN | Flag.OTHER_HEAD
)


def evaluate_forces(
    calibration: Calibration,
    forces_N: Sequence[float] | None = None,
    places_mm: Sequence[Place] | None = None,
    *,
    settling_s: float | None = None,
    result: Result = Result.IN_USE,
) -> tuple[ExpandedForce, ...]:
    """Evaluate the uncertainty of forces of single settled loads, by places and then by forces.

    Each is of one frame, at a place that is known, by the head that calibrated.

    Parameters
    ----------
    calibration : calibration as issued.
    forces_N : stated forces; None: least, middle and greatest of the calibrated range.
    places_mm : stated places; None: places of the loads that the calibration was learned from.
    settling_s : time after a press's ramp; None: the calibrated hold.
    result : force on the day of calibration, or in use.

    Raises
    ------
    CalibrationError
        If the calibration has no force model, no measured range of force (without ``forces_N``), or a place or force
        is outside what it, or the certificate of its load cell, was calibrated for.
    """
    points = ForcePoints(calibration)
    hold_s = points.model.steady_s if settling_s is None else settling_s
    stated_N = list_forces(calibration) if forces_N is None else tuple(forces_N)
    stated_mm = list_places(calibration) if places_mm is None else tuple(places_mm)
    if not hold_s >= 0:
        raise CalibrationError(f"a settling time of {hold_s} s is negative", remedy="state one of at least 0 s")
    for problem in _find_problems(calibration, stated_N, stated_mm):
        raise CalibrationError(problem, remedy="state what was calibrated, or calibrate again with what covers it")
    listing = ForceInputs(calibration, points.model, hold_s)
    grid = [points.at(force_N, place_mm) for place_mm in stated_mm for force_N in stated_N]
    return tuple(_expand(point, *listing.list_at(point, result), hold_s) for point in grid)


@dataclass(frozen=True, slots=True)
class ReferencePress:
    """What a load cell read of one press that was not learned from.

    Parameters
    ----------
    place_mm, settling_s : stated place, and time of the frame after the press's ramp.
    force_N, stderr_N, samples : mean of the samples over that frame, its standard error, and their number.
    steady_N : mean over all steady frames, by which the press lies in the calibrated range.
    """

    place_mm: Place
    settling_s: float
    force_N: float
    stderr_N: float
    samples: int
    steady_N: float


def evaluate_errors(calibration: Calibration, presses: Sequence[ReferencePress]) -> tuple[ExpandedForce, ...]:
    """Evaluate the uncertainty of the error that each press shows: indicated, by one frame, less reference force.

    CalibrationError as for :func:`evaluate_forces`.
    """
    points = ForcePoints(calibration)
    in_range = _find_problems(calibration, [one.steady_N for one in presses], [one.place_mm for one in presses])
    for problem in chain(in_range, _find_uncovered(calibration, [one.force_N for one in presses])):
        raise CalibrationError(problem, remedy="calibrate again with what covers it")
    expanded = []
    for press in presses:
        point = points.at(press.force_N, press.place_mm)
        listing = ForceInputs(calibration, points.model, press.settling_s)
        inputs, not_stated = listing.list_at(point, Result.ERROR)
        if press.samples < 2:
            not_stated.append(_CELL_SCATTER)
        else:
            source, dof = f"{press.samples} samples of this press", float(press.samples - 1)
            inputs.append(ForceInput(_CELL_SCATTER, "A", Entry.NEWTON, press.stderr_N, source, dof=dof))
        expanded.append(_expand(point, inputs, not_stated, press.settling_s))
    return tuple(expanded)


def _expand(
    point: ForcePoint, inputs: Sequence[ForceInput], not_stated: Sequence[str], settling_s: float
) -> ExpandedForce:
    budget = combine([item.as_input(point) for item in inputs], not_stated=not_stated)
    return ExpandedForce(point.place_mm, point.force_N, settling_s, budget, simulate_force(point, inputs, budget))


def expand_forces(calibration: Calibration, forces: Forces) -> tuple[ExpandedForce | None, ...]:
    """Return the uncertainty of each force that frames told, at the place where it was found.

    It is that of a force in use. What ``stderr_N`` of a frame has beyond a known place (the error of its place, other
    heads, readings left out) is one more input. None for frames without a load, for what is flagged as outside the
    calibrated range, and for forces that the load cell's certificate does not cover. CalibrationError without a force
    model.
    """
    points = ForcePoints(calibration)
    listing = ForceInputs(calibration, points.model, points.model.steady_s)
    expanded: list[ExpandedForce | None] = []
    for frame, force_N in enumerate(forces.force_N.tolist()):
        uncovered = any(_find_uncovered(calibration, (force_N,)))
        if forces.flags[frame] & _NO_CLAIM or not force_N > 0 or uncovered:
            expanded.append(None)
            continue
        x_mm, y_mm = forces.place_mm[frame].tolist()
        point = points.at(force_N, (x_mm, y_mm))
        inputs, not_stated = listing.list_at(point, Result.IN_USE)
        known = sum((item.as_input(point).contribution / item.widened) ** 2 for item in inputs if item.in_runtime)
        scatter = forces.stderr_N[frame] ** 2 - forces.shared_stderr_N[frame] ** 2
        beyond_N = sqrt(max(float(scatter) - known, 0.0))
        inputs.append(ForceInput("place found in the frame", "A", Entry.NEWTON, beyond_N, "the frame's own error"))
        expanded.append(_expand(point, inputs, not_stated, points.model.steady_s))
    return tuple(expanded)


def list_forces(calibration: Calibration) -> tuple[float, ...]:
    """Return least, middle and greatest force of the calibrated range. CalibrationError if it was not measured."""
    if calibration.validity.force_N is None:
        raise CalibrationError(
            f"the range of force of calibration {calibration.calibration} was not measured",
            remedy="run a recipe on a station with a load cell",
        )
    low_N, high_N = calibration.validity.force_N
    return tuple(dict.fromkeys((low_N, (low_N + high_N) / 2, high_N)))


def list_places(calibration: Calibration) -> tuple[Place, ...]:
    """Return the places that calibrated, each once; the sheet's centre if none did."""
    places = [(place.x_mm, place.y_mm) for place in calibration.baseline if place.value is not None]
    return tuple(dict.fromkeys(places)) or ((0.0, 0.0),)


def _find_problems(calibration: Calibration, forces_N: Sequence[float], places_mm: Sequence[Place]) -> Iterator[str]:
    """Yield what is outside the calibrated range, or the standards'."""
    low_N, high_N = calibration.validity.force_N or (0.0, inf)
    for force_N in forces_N:
        if not (force_N > 0 and low_N <= force_N <= high_N):
            yield f"a force of {force_N:.3g} N is outside the calibrated range, {low_N:.3g} to {high_N:.3g} N"
    for x_mm, y_mm in places_mm:
        if not hypot(x_mm, y_mm) <= calibration.validity.radius_mm + _ROUNDING_MM:
            reach = f"within {calibration.validity.radius_mm:.3g} mm of the centre"
            yield f"({x_mm:zg}, {y_mm:zg}) mm is outside the calibrated area, {reach}"
    yield from _find_uncovered(calibration, forces_N)


def _find_uncovered(calibration: Calibration, forces_N: Sequence[float]) -> Iterator[str]:
    """Yield forces, and a current, that certificates do not cover."""
    load_cell = find_standard(calibration.standards, StandardRole.LOAD_CELL)
    for force_N in forces_N:
        if load_cell is not None and not load_cell.covers(force_N):
            certificate = f"certificate {load_cell.certificate} of the load cell covers {load_cell.range_words()}"
            yield f"{force_N:.3g} N is outside its standard's range: {certificate}"
    meter = find_standard(calibration.standards, StandardRole.SOURCE_METER)
    current_mA = 1e3 * calibration.current_A
    if meter is not None and not meter.covers(current_mA):
        certificate = f"certificate {meter.certificate} of the source meter covers {meter.range_words()}"
        yield f"the drive current was {current_mA:.3g} mA: {certificate}"
