"""E_CoM: how far the sensed region's centre of mass is from the indenter's centre (paper Eq 4)."""

from typing import Any, ClassVar

from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa.imaging.shape import centre_of_mass_error_mm
from cbsr_qa_plugins.metrics._shared import at_load, masks_of, refuse_unknown, why_not


class CentreOfMassError:
    """``centre_of_mass_error`` [mm] of every load, for every percentage mask.

    It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"centre_of_mass_error": "mm"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("centre-of-mass-error", options)

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure the sensed blob under each mask; without a blob there is no value."""
        place = load.record.load
        pressed = load.indenter.at(place.x_mm, place.y_mm)
        return tuple(
            at_load(
                load,
                "centre_of_mass_error",
                None if view.region is None else centre_of_mass_error_mm(view.region, pressed),
                "mm",
                qualifier=qualifier,
                how=why_not(view) if view.region is None else "area- and value-weighted centre of mass",
            )
            for view, qualifier in masks_of(load, run)
        )
