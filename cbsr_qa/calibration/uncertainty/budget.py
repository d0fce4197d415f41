"""Budgets of forces that a calibrated sensor tells (JCGM 100)."""

from collections.abc import Sequence

from cbsr_qa.domain.results.calibration import Calibration
from cbsr_qa.domain.results.expanded_force import ExpandedForce


def evaluate_forces(
    calibration: Calibration,
    forces_N: Sequence[float] | None = None,
    places_mm: Sequence[tuple[float, float]] | None = None,
    *,
    settling_s: float | None = None,
) -> tuple[ExpandedForce, ...]:
    """Evaluate the uncertainty of forces of single settled loads, by places and then by forces.

    Parameters
    ----------
    calibration : calibration as issued.
    forces_N : stated forces; None: least, middle and greatest of the calibrated range.
    places_mm : stated places; None: places of the loads that the calibration was learned from.
    settling_s : time after a press's ramp; None: the calibrated hold.

    Raises
    ------
    CalibrationError
        If the calibration has no force model, no measured range of force (without ``forces_N``), or a place or force
        is outside what it was calibrated for.
    """
    raise NotImplementedError
