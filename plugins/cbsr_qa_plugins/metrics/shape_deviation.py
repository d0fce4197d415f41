"""SD: mean squared distance of the sensed region's outline from the indenter's (paper Eq 6)."""

from typing import Any, ClassVar

from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa.imaging.shape import shape_deviation_mm2
from cbsr_qa_plugins.metrics._shared import at_load, masks_of, refuse_unknown, why_not


class ShapeDeviation:
    """``shape_deviation`` [mm²] of every load, for every percentage mask.

    Never to be judged alone: a speck on the indenter's rim deviates by 0.2 mm² at an E_CoM of 6.5 mm.
    The mean runs over the outline's length or its nodes, as the recipe's analysis settings say; there are no
    options.
    """

    measures: ClassVar[dict[str, str]] = {"shape_deviation": "mm²"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("shape-deviation", options)

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure the sensed blob under each mask; without a blob there is no value."""
        place, mode = load.record.load, run.settings.perimeter
        pressed = load.indenter.at(place.x_mm, place.y_mm)
        measured: list[Measurement] = []
        for view, qualifier in masks_of(load, run):
            value, how = None, why_not(view)
            if view.region is not None:
                value = shape_deviation_mm2(view.region, pressed, mode)
                how = f"mean over the outline's {mode}"
            measured.append(at_load(load, "shape_deviation", value, "mm²", qualifier=qualifier, how=how))
        return tuple(measured)
