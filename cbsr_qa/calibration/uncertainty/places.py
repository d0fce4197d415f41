"""Budgets of places that the model of the sheet tells (JCGM 100; JCGM 102 for two axes together)."""

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, sqrt
from typing import Final

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

from cbsr_qa.calibration.force.template_matching import TemplateFilter
from cbsr_qa.calibration.uncertainty.budget import Place, list_forces, list_places
from cbsr_qa.calibration.uncertainty.combination import COVERAGE, BudgetInput, combine
from cbsr_qa.calibration.uncertainty.force_point import ForcePoints
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.standards import StandardRole, find_standard
from cbsr_qa.domain.results.calibration import Calibration
from cbsr_qa.domain.results.expanded_force import ExpandedPlace

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
    matched = TemplateFilter(points.model)
    stage = find_standard(calibration.standards, StandardRole.STAGE)
    stage_mm = 0.0 if stage is None else hypot(stage.standard_uncertainty, (stage.resolution or 0.0) / sqrt(12))
    expanded = []
    for place_mm in list_places(calibration) if places_mm is None else places_mm:
        for force_N in list_forces(calibration) if forces_N is None else forces_N:
            noise = _noise_covariance(matched, points.at(force_N, place_mm).strength, place_mm)
            scatter_mm = points.model.place_scatter_mm
            inputs = [
                BudgetInput("noise of a frame", "A", sqrt(np.trace(noise) / 2), 1.0, "the run's frames at rest"),
                BudgetInput("scatter of places", "A", scatter_mm, 1.0, "places found of the run's loads"),
            ]
            if stage is not None:
                inputs.append(BudgetInput("place of indentation", "B", stage_mm, 1.0, stage.words(), shared=True))
            budget = combine(inputs, not_stated=() if stage is not None else ("place of indentation",))
            whole = noise + (scatter_mm**2 + stage_mm**2) * np.eye(2)
            k = radius_of_circle(whole) / budget.standard_uncertainty
            expanded.append(ExpandedPlace(place_mm, force_N, replace(budget, k=k)))
    return tuple(expanded)


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


def _noise_covariance(matched: TemplateFilter, strength: float, place_mm: Place) -> Array:
    """Covariance (2, 2) of a place by the noise of one frame, its strength being found with it [mm²]."""
    (slopes,) = matched.template_and_slopes(np.array([place_mm], dtype=np.float64))
    rows = slopes * np.array([1.0, strength, strength])[:, None]
    covariance: Array = np.linalg.inv(rows @ rows.T)[1:, 1:]
    return covariance
