"""Where a hold ends that nobody said when and how fast it began: averaged over what both may have been."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibrate.steady_state import HoldsSoFar
from cbsr_qa.domain.relaxation import RelaxationKernel

Array = NDArray[np.float64]

#: How long a press may take, from a tap to a slow indenter [s], and when it may have ended about where it is taken to
#: [frames], each with what is thought of it beforehand.
_RAMPS_S: Final = np.array([0.3, 1.2, 3.0])
_OF_RAMPS: Final = np.array([0.25, 0.5, 0.25])
_ENDS: Final = np.array([-0.5, -0.25, 0.0, 0.25])
_OF_ENDS: Final = np.array([0.1, 0.2, 0.5, 0.2])
#: Half a frame over the fastest time constant that is still averaged.
_LONGEST: Final = 20.0


class UnsureHold:
    """One hold as frames show it, with the ramp before it unseen.

    Each pair of a ramp's length and end makes a regression of its own
    (:class:`~cbsr_qa.calibrate.steady_state.HoldsSoFar`); they are averaged with how well they explain the frames.

    Parameters
    ----------
    kernel : of loadings, without a reason against it.
    frame_s : what a frame takes.
    """

    def __init__(self, kernel: RelaxationKernel, frame_s: float) -> None:
        ramps, ends = (grid.ravel() for grid in np.meshgrid(_RAMPS_S, _ENDS * frame_s))
        self._prior: Array = np.log(np.outer(_OF_ENDS, _OF_RAMPS).ravel())
        self._late_s = ends
        self.frames = 0
        fastest_s = float(kernel.time_constants_s[0]) if len(kernel.time_constants_s) else np.inf
        seen_s = min(frame_s, 2 * _LONGEST * fastest_s)
        self._holds = HoldsSoFar(kernel, len(ramps), ramp_s=ramps, frame_s=seen_s)

    def add(self, held_s: float, value: float, noise: float) -> None:
        """Take in a frame: time since the ramp is taken to have ended, strength and its standard deviation."""
        self.frames += 1
        self._holds.add(np.maximum(held_s - self._late_s, 0.0), value, noise)

    def predict(self, at_s: float) -> tuple[float, float]:
        """Strength at a time after the ramp's end, and its standard error."""
        each = self._holds.predict(at_s=at_s)
        log_weight = self._prior - each.misfit * each.spare / 2
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        value = float(weight @ each.values)
        variance = float(weight @ (each.stderr**2 + (each.values - value) ** 2))
        return value, float(np.sqrt(variance))
