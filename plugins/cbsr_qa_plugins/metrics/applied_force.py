"""The force that was applied while the steady image was taken."""

from typing import Any, ClassVar

from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa_plugins.metrics._shared import at_load, refuse_unknown


class AppliedForce:
    """``force`` [N] of each load: the load cell's mean over the steady frames. It has no options."""

    measures: ClassVar[dict[str, str]] = {"force": "N"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("applied-force", options)

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; without a load cell there is no value."""
        how = "no force was recorded" if load.force_N is None else f"mean over {load.steady_frames} steady frames"
        return (at_load(load, "force", load.force_N, "N", uncertainty=load.force_stderr_N, how=how),)
