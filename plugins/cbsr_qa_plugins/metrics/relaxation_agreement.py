"""Whether the blobs relax as the whole image does."""

from typing import Any, ClassVar

from cbsr_qa.analysis.run_agreement import image_against_blobs
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa_plugins.metrics._agreement import said_of_shape, said_of_time
from cbsr_qa_plugins.metrics._shared import refuse_unknown


class BlobAndImageRelaxation:
    """``relaxation_shape_difference`` [1] and ``relaxation_time_ratio`` [1]: image against blobs, press and release.

    The mean of the whole image is there without a mask and without a blob: if it relaxes otherwise than the blobs,
    the mask moves, or something else than the loads does. Both are fitted over all loads that show both. The first is
    the difference of the curves over the steady change (after a release over the released one) where it may be
    largest, the second that of the settling times. ``how`` says whether that is equivalent within 0.1 of the change
    and within 20 % of the time, which is tested, or different, or undecided. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"relaxation_shape_difference": "1", "relaxation_time_ratio": "1"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("relaxation-agreement", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Compare loadings and unloadings."""
        taken = []
        for one in image_against_blobs(run):
            found, qualifier = one.found, f"image against conductance, {one.direction}"
            shape, time = said_of_shape(one), said_of_time(one)
            taken += [
                Measurement(
                    "relaxation_shape_difference", found.shape_difference, "1", found.shape_stderr,
                    qualifier=qualifier, how=shape,
                ),
                Measurement(
                    "relaxation_time_ratio", found.time_ratio, "1", found.time_ratio_stderr,
                    qualifier=qualifier, how=time,
                ),
            ]  # fmt: skip
        return tuple(taken)
