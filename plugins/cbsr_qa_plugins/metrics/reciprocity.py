"""Reciprocity: exchanging drive and measure pair must not change a reading."""

from typing import Any, ClassVar

import numpy as np

from cbsr_qa.analysis.channel_quality import reciprocity_errors
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa_plugins.metrics._shared import flag, refuse_unknown


class ReciprocityError:
    """``reciprocity_error`` [1] of the reference frame: rms |V_ij − V_ji| over rms |V| of the imaged readings.

    Of patterns that drive other pairs than they measure the readings that are still reciprocal to each other are
    taken, see :meth:`cbsr_qa.domain.patterns.DrivePattern.reciprocal_pairs`.

    Multiplexers that keep a share of the previous reading break reciprocity too: a large value is a reason to look,
    not yet an electrode fault. With qualifier ``"worst"`` the largest |V_ij − V_ji| over the same rms; with the
    option ``every = true`` each pair's is a measurement of its own, ``"drive 3, measure 7"``.
    """

    measures: ClassVar[dict[str, str]] = {"reciprocity_error": "1"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("reciprocity", options, ("every",))
        self._every = flag("reciprocity", options, "every")

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; patterns without reciprocal readings have no value."""
        pairs, errors = reciprocity_errors(run.reference, run.record.sensor_type.pattern, run.usable)
        if not errors.size:
            why = "no imaged reading has a reciprocal one, or all are zero"
            return tuple(Measurement("reciprocity_error", None, "1", qualifier=q, how=why) for q in ("", "worst"))
        together = f"rms over {errors.size} pairs of readings of the reference frame"
        names = [_name(int(first), run) for first in pairs[:, 0]]
        worst = int(errors.argmax())
        found = [
            Measurement("reciprocity_error", float(np.sqrt(np.mean(errors**2))), "1", how=together),
            Measurement("reciprocity_error", float(errors[worst]), "1", qualifier="worst", how=names[worst]),
        ]
        if self._every:
            found += [
                Measurement(
                    "reciprocity_error", float(error), "1", qualifier=name, how="against its reciprocal reading"
                )
                for name, error in zip(names, errors, strict=True)
            ]
        return tuple(found)


def _name(reading: int, run: RunObservation) -> str:
    drive, measure = divmod(reading, run.usable.shape[1])
    return f"drive {drive}, measure {measure}"
