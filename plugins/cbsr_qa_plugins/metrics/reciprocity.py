"""Reciprocity: exchanging drive and measure pair must not change a reading."""

from typing import Any, ClassVar

import numpy as np

from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa_plugins.metrics._shared import refuse_unknown


class ReciprocityError:
    """``reciprocity_error`` [1] of the reference frame: rms |V_ij − V_ji| over rms |V| of the imaged readings.

    Of patterns that drive other pairs than they measure the readings that are still reciprocal to each other are
    taken, see :meth:`cbsr_qa.domain.patterns.DrivePattern.reciprocal_pairs`.

    Multiplexers that keep a share of the previous reading break reciprocity too: a large value is a reason to look,
    not yet an electrode fault. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"reciprocity_error": "1"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("reciprocity", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; patterns without reciprocal readings have no value."""
        pairs, sign = run.record.sensor_type.pattern.reciprocal_pairs()
        both = run.usable.ravel()[pairs].all(axis=1)
        first, second = run.reference.ravel()[pairs[both]].T
        level = float(np.sqrt(np.mean(np.concatenate([first, second]) ** 2))) if both.any() else 0.0
        if level == 0:
            return (_refused("no imaged reading has a reciprocal one, or all are zero"),)
        error = float(np.sqrt(np.mean((first - sign[both] * second) ** 2))) / level
        how = f"rms over {int(both.sum())} pairs of readings of the reference frame"
        return (Measurement("reciprocity_error", error, "1", how=how),)


def _refused(why: str) -> Measurement:
    return Measurement("reciprocity_error", None, "1", how=why)
