"""One force at one place, as the model of force tells it: how it answers to each kind of error. Numpy alone.

A strength a, the response S of the place and the line σ = (κ/S − β)/α, κ = 2a/(2 − a), give a force F = σ A (see
:mod:`cbsr_qa.calibration.force.inverse`). Errors enter at one of five points of it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from cbsr_qa.calibration.force.interpolation import interpolate
from cbsr_qa.calibration.force.inverse import ForceInverse, map_tables
from cbsr_qa.calibration.force.template_matching import TemplateFilter
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.calibration import Calibration, ForceModel


class Entry(StrEnum):
    """Point of the model at which an error enters."""

    STRENGTH = "strength"  #: added to a
    RESPONSE = "log_response"  #: added to ln S
    LINE = "line"  #: added to α σ + β, the change that the line predicts
    FACTOR = "factor"  #: added to a factor 1 of the force
    NEWTON = "newton"  #: added to the force [N]


@dataclass(frozen=True, slots=True, eq=False)
class ForcePoint:
    """A stated force at a stated place.

    Parameters
    ----------
    place_mm, force_N : place and force.
    strength : a of that force there.
    response_stderr : standard error of ln S.
    noise : standard deviation of a by the noise of one frame.
    gain : change of a by a common relative change of all readings.
    slope_per_mm : (2,) relative change of the force by a displacement, at the same readings.
    per_change : newtons per relative change of conductance, A/α.
    intercept : β.
    """

    place_mm: tuple[float, float]
    force_N: float
    strength: float
    response_stderr: float
    noise: float
    gain: float
    slope_per_mm: Array
    per_change: float
    intercept: float

    @property
    def change(self) -> float:
        """κ/S, the relative change of conductance of a sheet that responds like its material."""
        return self.force_N / self.per_change + self.intercept

    def sensitivity(self, entry: Entry) -> float:
        """Derivative of the force by an error that enters there."""
        return {
            Entry.STRENGTH: self.per_change * self.change * 2 / (self.strength * (2 - self.strength)),
            Entry.RESPONSE: -self.per_change * self.change,
            Entry.LINE: -self.per_change,
            Entry.FACTOR: self.force_N,
            Entry.NEWTON: 1.0,
        }[entry]

    def bend(self, entry: Entry) -> float:
        """Second derivative of the force by an error that enters there."""
        if entry is Entry.STRENGTH:
            return self.sensitivity(entry) * 2 / (2 - self.strength)
        return self.per_change * self.change if entry is Entry.RESPONSE else 0.0

    def force_with(self, errors: Mapping[Entry, Array]) -> Array:
        """Return forces (n,) with errors (n,) by where they enter, without any approximation."""
        nothing = np.zeros(1)
        strength = np.minimum(self.strength + errors.get(Entry.STRENGTH, nothing), 1.98)
        ratio = strength * (2 - self.strength) / (self.strength * (2 - strength))
        change = self.change * ratio * np.exp(-errors.get(Entry.RESPONSE, nothing))
        plain = (change - self.intercept - errors.get(Entry.LINE, nothing)) * self.per_change
        return plain * (1 + errors.get(Entry.FACTOR, nothing)) + errors.get(Entry.NEWTON, nothing)


class ForcePoints:
    """Makes points of one calibration.

    CalibrationError if it has no force model.

    Attributes
    ----------
    reference_rows : (r,) rows of the unloaded frame itself: what a common relative change of all readings adds.
    """

    def __init__(self, calibration: Calibration) -> None:
        if calibration.force is None:
            raise CalibrationError(
                f"calibration {calibration.calibration} states no force, and so no uncertainty of it:"
                f" {calibration.no_force}",
                remedy="calibrate the sensor again: run a recipe whose calibration phases press three places or more",
            )
        self.model: ForceModel = calibration.force
        self._calibration = calibration
        self._filter = TemplateFilter(self.model)
        self._inverse = ForceInverse(
            self.model, calibration.against_stress, calibration.indenter.area_mm2, map_tables(self.model)
        )
        reference = calibration.reference[calibration.reconstruction.problem.used]
        self.reference_rows: Array = self.model.merging @ reference

    def at(self, force_N: float, place_mm: tuple[float, float]) -> ForcePoint:
        """Return the point of a force at a place. CalibrationError where the calibration knows no force."""
        places_mm = np.array([place_mm], dtype=np.float64)
        (template,) = self._filter.template(places_mm)
        (strength,) = self._inverse.strength(np.array([force_N]), places_mm)
        if not (np.isfinite(template).all() and np.isfinite(strength) and strength != 0):
            x_mm, y_mm = place_mm
            raise CalibrationError(
                f"({x_mm:zg}, {y_mm:zg}) mm with {force_N:g} N is outside what this calibration knows",
                remedy="state a place and a force within its range of use",
            )
        mapped = interpolate(self.model, self._inverse.tables, places_mm)[0]
        energy = float(template @ template)
        line = self._calibration.against_stress
        per_change = self._calibration.indenter.area_mm2 / 1e3 / line.slope.value
        point = ForcePoint(
            place_mm,
            force_N,
            float(strength),
            float(mapped[1]),
            1 / energy**0.5,
            float(template @ self.reference_rows) / energy,
            np.zeros(2),
            per_change,
            line.intercept.value,
        )
        by_size = -point.strength * self._filter.size_slope(places_mm)[0] * point.sensitivity(Entry.STRENGTH)
        by_map = point.sensitivity(Entry.RESPONSE) * mapped[2:]
        point.slope_per_mm[:] = (by_size + by_map) / force_N
        return point
