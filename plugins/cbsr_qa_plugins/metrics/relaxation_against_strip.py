"""Whether a sheet relaxes as a strip of its material did: the 1D against the 2D test."""

from collections.abc import Iterator
from typing import Any, ClassVar

from cbsr_qa.analysis.run_agreement import DirectedAgreement, sheet_against_strip
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa_plugins.metrics._agreement import said_of_shape, said_of_time
from cbsr_qa_plugins.metrics._shared import refuse_unknown


class SheetAndStripRelaxation:
    """How a sheet's loads creep and fade, against a strip of its material, after presses and after releases.

    ``strip_relaxation_difference`` [1]: the curves' difference, sheet less strip, over the steady (the released)
    change where it may be largest. ``strip_relaxation_time_ratio`` [1]: of the settling times, sheet over strip.
    ``strip_relaxation_difference_bound`` and ``strip_relaxation_time_bound`` [1]: the largest difference, and the
    largest ratio either way, that the data leave open at 5 %. A limit on these two is a test of equivalence, which no
    amount of noise passes: 0.1 and 1.2 are the margins that ``how`` states.

    The strip's relaxation is that of the material file the run was given (``cbsr-qa run --material``); without one
    nothing has a value, and ``how`` says why. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {
        "strip_relaxation_difference": "1",
        "strip_relaxation_difference_bound": "1",
        "strip_relaxation_time_ratio": "1",
        "strip_relaxation_time_bound": "1",
    }

    def __init__(self, **options: Any) -> None:
        refuse_unknown("relaxation-against-strip", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Compare loadings and unloadings."""
        return tuple(taken for one in sheet_against_strip(run) for taken in _measured(one))


def _measured(one: DirectedAgreement) -> Iterator[Measurement]:
    found = one.found
    shape, time = said_of_shape(one), said_of_time(one)
    for name, value, stderr, how in (
        ("strip_relaxation_difference", found.shape_difference, found.shape_stderr, shape),
        ("strip_relaxation_difference_bound", found.shape_reach, None, shape),
        ("strip_relaxation_time_ratio", found.time_ratio, found.time_ratio_stderr, time),
        ("strip_relaxation_time_bound", found.time_reach, None, time),
    ):
        yield Measurement(name, value, "1", stderr, qualifier=one.direction, how=how)
