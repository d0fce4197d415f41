"""One draw of presses, learned as by ``cbsr-qa calibrate``; others are located."""

import time
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.calibration.place.estimator import PlaceEstimator
from cbsr_qa.calibration.place.mixture import mahalanobis
from cbsr_qa.calibration.presses.inputs import LabelledPresses
from cbsr_qa.calibration.presses.learning import learn_presses
from cbsr_qa.domain.numbers import Array, Indices, Mask

#: Frames located one by one to measure the time.
_TIMED: Final = 20


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """Presses located after learning from others.

    Parameters
    ----------
    located : (k,) rows of the located presses.
    error_mm : (k,) distance of the places found from the true ones.
    inside : (k, 2) whether the regions of 68 and 95 % hold the true places.
    in_model : (k,) whether each was recognised as a touch like those learned from.
    learning_s, frame_s : time of registering and learning, and of locating one frame.
    """

    located: Indices
    error_mm: Array
    inside: Mask
    in_model: Mask
    learning_s: float
    frame_s: float


def try_presses(labelled: LabelledPresses, learned: Indices, located: Indices) -> Trial:
    """Register and learn from some presses alone, and locate others.

    RecordingError or CalibrationError if nothing can be learned from these presses.
    """
    begin = time.perf_counter()
    model = learn_presses(labelled.select(learned)).place.model
    locate = PlaceEstimator(model, pairs=labelled.readings.distinct.pairs)
    learning_s = time.perf_counter() - begin
    changes, true_mm = labelled.readings.changes[located], labelled.presses.place_mm[located]
    begin = time.perf_counter()
    for frame in changes[:_TIMED, None]:
        locate(frame)
    frame_s = (time.perf_counter() - begin) / len(changes[:_TIMED])
    places = locate(changes)
    error = true_mm - places.place_mm
    square = mahalanobis(error, places.covariance_mm2)
    is_inside = square[:, None] <= [locate.q68, locate.q95]
    return Trial(located, np.linalg.norm(error, axis=1), is_inside, places.in_model, learning_s, frame_s)
