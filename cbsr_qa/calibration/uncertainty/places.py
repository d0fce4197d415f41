"""Budgets of places that the model of the sheet tells (JCGM 100; JCGM 102 for two axes together)."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import sqrt
from typing import Final

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

from cbsr_qa.calibration.force.template_matching import TemplateFilter
from cbsr_qa.calibration.uncertainty.budget import Place, list_forces, list_places
from cbsr_qa.calibration.uncertainty.combination import COVERAGE, BudgetInput, combine
from cbsr_qa.calibration.uncertainty.force_point import ForcePoints
from cbsr_qa.calibration.uncertainty.inputs import combine_standard, name_left_out
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.standards import IN_USE_YEARS, StandardRole, find_standard
from cbsr_qa.domain.results.calibration import Calibration
from cbsr_qa.domain.results.expanded_force import GAIN_DRIFT, ExpandedPlace

#: Least ratio of the axes' variances: below it the region is a line.
_LINE: Final = 1e-6


def evaluate_places(
    calibration: Calibration,
    forces_N: Sequence[float] | None = None,
    places_mm: Sequence[Place] | None = None,
) -> tuple[ExpandedPlace, ...]:
    """Evaluate the uncertainty of places of single loads that one frame tells, by places and then by forces.

    U is the radius of the circle that holds the place with 95 %.

    Parameters
    ----------
    forces_N, places_mm : as for :func:`~cbsr_qa.calibration.uncertainty.budget.evaluate_forces`.

    Raises
    ------
    CalibrationError
        As for that function, and if the calibration's places are learned from presses: those state regions of their
        own.
    """
    if calibration.place is not None:
        raise CalibrationError(
            "the places of this calibration are learned from its presses",
            remedy="take the region that the runtime gives for each frame",
        )
    points = ForcePoints(calibration)
    listing = _PlaceInputs(calibration, points)
    return tuple(
        listing.expand(force_N, place_mm)
        for place_mm in (list_places(calibration) if places_mm is None else places_mm)
        for force_N in (list_forces(calibration) if forces_N is None else forces_N)
    )


class _PlaceInputs:
    """Inputs of places: each has a covariance (2, 2) of its displacements."""

    def __init__(self, calibration: Calibration, points: ForcePoints) -> None:
        self._points = points
        self._matched = TemplateFilter(points.model)
        self._issued_at = calibration.issued_at
        self._stage = find_standard(calibration.standards, StandardRole.STAGE)
        self._meter = find_standard(calibration.standards, StandardRole.SOURCE_METER)

    def expand(self, force_N: float, place_mm: Place) -> ExpandedPlace:
        inputs, not_stated, whole = [], [], np.zeros((2, 2))
        for name, kind, covariance, source, is_shared in self._list(force_N, place_mm):
            if covariance is None:
                not_stated.append(name)
                continue
            whole += covariance
            u_mm = sqrt(float(np.trace(covariance)) / 2)
            inputs.append(BudgetInput(name, kind, u_mm, 1.0, source, shared=is_shared))
        budget = combine(inputs, not_stated=not_stated)
        k = radius_of_circle(whole) / budget.standard_uncertainty
        return ExpandedPlace(place_mm, force_N, replace(budget, k=k))

    def _list(self, force_N: float, place_mm: Place) -> Iterator[tuple[str, str, Array | None, str, bool]]:
        """Yield name, kind, covariance (None if nothing gives a number), source, and whether it is shared."""
        (slopes,) = self._matched.template_and_slopes(np.array([place_mm], dtype=np.float64))
        strength = self._points.at(force_N, place_mm).strength
        rows = slopes * np.array([1.0, strength, strength])[:, None]
        covariance = np.linalg.inv(rows @ rows.T)
        yield "noise of a frame", "A", covariance[1:, 1:], "the run's frames at rest", False
        scatter_mm = self._points.model.place_scatter_mm
        yield "scatter of places", "A", scatter_mm**2 * np.eye(2), "places found of the run's loads", False
        drift = None if self._meter is None else self._meter.drift_uncertainty(IN_USE_YEARS)
        if drift is None or self._meter is None:
            yield GAIN_DRIFT, "B", None, "", True
        else:
            moved_mm = drift * (covariance @ rows @ self._points.reference_rows)[1:]
            yield GAIN_DRIFT, "B", np.outer(moved_mm, moved_mm), self._meter.words(), True
        if self._stage is None:
            yield "place of indentation", "B", None, "", True
        else:
            u_mm = combine_standard(self._stage, self._issued_at)
            for name in name_left_out(self._stage):
                yield name, "B", None, "", True
            yield "place of indentation", "B", u_mm**2 * np.eye(2), self._stage.words(), True


def radius_of_circle(covariance: Array, coverage: float = COVERAGE) -> float:
    """Return the radius of the circle that holds a normal pair of this covariance (2, 2) with a probability.

    The probability is ∫ (1 − e^(−r² q/2)) / (2π √(λ₁λ₂) q) dθ, q = cos²θ/λ₁ + sin²θ/λ₂.
    """
    smaller, larger = np.linalg.eigvalsh(covariance).tolist()
    if not larger > 0:
        return 0.0
    ratio = max(smaller / larger, _LINE)

    def missing(radius: float) -> float:
        def density(angle: float) -> float:
            q = np.cos(angle) ** 2 + np.sin(angle) ** 2 / ratio
            return float(-np.expm1(-(radius**2) * q / 2) / q)

        held = quad(density, 0, np.pi / 2, limit=200)[0] * 2 / (np.pi * sqrt(ratio))
        return float(held) - coverage

    return float(brentq(missing, 0.1, 10.0)) * sqrt(larger)
