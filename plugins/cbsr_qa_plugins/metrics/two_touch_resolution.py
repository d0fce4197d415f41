"""How far apart two equal loads must be to be seen as two, with this run's reconstruction."""

from typing import Any, ClassVar, Final

from cbsr_qa.domain.measurement import Bound, Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa.imaging.two_touch import TwoTouch, two_touch_resolution
from cbsr_qa_plugins.metrics._shared import refuse_unknown

#: Highest mask that is tried: at the maximum itself there is nothing to count.
_HIGHEST: Final = 0.99


class TwoTouchResolution:
    """``two_touch_resolution`` [mm]: smallest distance of two equal loads from which on two regions are seen.

    Without qualifier for contours at the run's main mask, with ``"watershed"`` for peaks parted along the valley
    between them. Of the linearised model, without noise, along a line through the sheet's centre; the readings that
    were imaged are the run's. Where two are not seen up to 0.8 of the sheet's radius, that is a lower bound. It has
    no options.
    """

    measures: ClassVar[dict[str, str]] = {"two_touch_resolution": "mm"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("two-touch-resolution", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure both ways."""
        mask = min(run.main_mask, _HIGHEST)
        found = (
            ("", f"contours at {100 * mask:g} %", mask),
            ("watershed", "valleys 5 % deep under the 25 % mask", None),
        )
        return tuple(
            _measurement(two_touch_resolution(run.reconstruction, run.record.indenter, mask=fraction), qualifier, how)
            for qualifier, how, fraction in found
        )


def _measurement(found: TwoTouch, qualifier: str, how: str) -> Measurement:
    name, words = "two_touch_resolution", f"{how}; steps of {found.step_mm:g} mm up to {found.tried_mm:g} mm"
    if found.separation_mm is None:
        return Measurement(
            name, found.tried_mm, "mm", qualifier=qualifier, how=f"{words}: never two", bound=Bound.LOWER
        )
    return Measurement(name, found.separation_mm, "mm", qualifier=qualifier, how=words)
