"""Whether the area of a region says anything about the size of what presses, with this run's reconstruction."""

from typing import Any, ClassVar

from cbsr_qa.analysis.size_response import SizeResponse, size_response_of
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa_plugins.metrics._shared import refuse_unknown


class SizeResponseMetric:
    """``size_response`` [1]: slope of a region's log area over the target's, 1 in proportion, 0 flat.

    One for the centre and one for 0.6 radii out, with round targets of 8/13, 1 and 20/13 of the head's diameter, at
    the run's main mask, without noise; ``region_area`` [mm²] of each target beside it, with its diameter in the
    qualifier. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"size_response": "1", "region_area": "mm²"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("size-response", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; where no target fits the sheet there is no value."""
        try:
            found = size_response_of(run)
        except NumericsError as error:
            return (Measurement("size_response", None, "1", how=error.reason),)
        measured = []
        for one in found:
            measured.append(Measurement("size_response", one.slope, "1", qualifier=one.place, how=_how(one, run)))
            for diameter, area in zip(one.diameters_mm, one.areas_mm2, strict=True):
                qualifier = f"{one.place}, target of {diameter:.3g} mm"
                why = "" if area is not None else "not detected: the target leaves no region"
                measured.append(Measurement("region_area", area, "mm²", qualifier=qualifier, how=why))
        return tuple(measured)


def _how(found: SizeResponse, run: RunObservation) -> str:
    if found.slope is None:
        return "not detected: targets leave no region"
    flat = "flat: targets of every size leave nearly the same region; " if found.flat else ""
    return f"{flat}mask {100 * run.main_mask:g} %, linearised model without noise"
