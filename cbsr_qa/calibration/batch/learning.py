"""The map of a sensor by its batch and its own loads, unless these show that it is not like its batch."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cbsr_qa.calibration.batch.loads import SensorLoads
from cbsr_qa.calibration.batch.prior import BatchPrior, Likeness
from cbsr_qa.calibration.batch.sensor_map import BatchMap
from cbsr_qa.calibration.sheet.response_map import FEWEST, ResponseMap, learn_response
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.calibration import BatchUse

#: A sensor is not like its batch if its loads are less probable than this by it, and more so of another batch.
_UNLIKE: Final = 0.05
#: Spacing and reach of the places over which the batch's share is averaged, over the radius of the sheet.
_PLACES, _REACH = 13, 0.8


@dataclass(frozen=True, slots=True)
class BatchLearner:
    """Learns maps as :func:`~cbsr_qa.calibration.sheet.response_map.learn_response` does, with a batch as prior.

    Parameters
    ----------
    digest : digest of the batch's model, which the map states.
    """

    prior: BatchPrior
    digest: str

    def __call__(
        self,
        places_mm: Array,
        log_response: Array,
        variance: Array,
        *,
        radius_mm: float,
        bend: Array | None = None,
        bend_stderr: float = 1.0,
    ) -> ResponseMap | BatchMap:
        """Return the map by batch and loads; that of the loads alone if they are not like the batch's.

        CalibrationError as of ``learn_response``.
        """
        if len(log_response) < FEWEST:
            raise CalibrationError(
                f"{len(log_response)} loads do not show whether a sensor is like its batch; {FEWEST} are needed",
                remedy="press more places, or press harder: loads must stand out of the noise",
            )
        loads = SensorLoads(places_mm, log_response, variance, bend, bend_stderr)
        likeness = self.prior.test_likeness(loads)
        if is_strange(likeness):
            alone = learn_response(
                places_mm, log_response, variance, radius_mm=radius_mm, bend=bend, bend_stderr=bend_stderr
            )
            return replace(alone, batch=BatchUse(self.digest, False, likeness.p_value, 0.0))
        learned = self.prior.learn_response(loads)
        axis = np.linspace(-_REACH * radius_mm, _REACH * radius_mm, _PLACES)
        lattice_mm = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
        share = learned.batch_share(lattice_mm[np.hypot(*lattice_mm.T) <= _REACH * radius_mm])
        learned.batch = BatchUse(self.digest, True, likeness.p_value, float(share.mean()))
        return learned


def is_strange(likeness: Likeness) -> bool:
    """Whether a sensor is not like its batch: improbable by it, and more probable as one of another batch."""
    return likeness.p_value < _UNLIKE and likeness.log_evidence < 0
