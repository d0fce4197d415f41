"""One hold of a stream, whose ramp was not observed."""

from typing import Final

import numpy as np

from cbsr_qa.calibration.fits.steady_state import HoldsSoFar
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.relaxation import RelaxationKernel

#: Possible durations of a press, from a tap to a slow indenter [s], and its possible end relative to the assumed one
#: [frames], each with prior weights.
_RAMPS_S: Final = np.array([0.3, 1.2, 3.0])
_RAMP_PRIORS: Final = np.array([0.25, 0.5, 0.25])
_ENDS_FRAMES: Final = np.array([-0.5, -0.25, 0.0, 0.25])
_END_PRIORS: Final = np.array([0.1, 0.2, 0.5, 0.2])
#: Half a frame over the fastest time constant that is averaged.
_MAX_HALF_FRAME_RATIO: Final = 20.0


class UnsureHold:
    """One hold as observed in frames, with an unobserved ramp before it.

    Each pair of a ramp's length and end has a separate regression (``HoldsSoFar``);
    they are averaged with their likelihoods.
    """

    def __init__(self, kernel: RelaxationKernel, frame_s: float) -> None:
        ramps, ends = (grid.ravel() for grid in np.meshgrid(_RAMPS_S, _ENDS_FRAMES * frame_s))
        self._prior: Array = np.log(np.outer(_END_PRIORS, _RAMP_PRIORS).ravel())
        self._late_s = ends
        self.frames = 0
        fastest_s = float(kernel.time_constants_s[0]) if len(kernel.time_constants_s) else np.inf
        seen_s = min(frame_s, 2 * _MAX_HALF_FRAME_RATIO * fastest_s)
        self._holds = HoldsSoFar(kernel, len(ramps), ramp_s=ramps, frame_s=seen_s)

    def add(self, held_s: float, value: float, noise: float) -> None:
        """Add a frame: time since the assumed end of the ramp, strength and its standard deviation."""
        self.frames += 1
        self._holds.add(np.maximum(held_s - self._late_s, 0.0), value, noise)

    def predict(self, at_s: float) -> tuple[float, float]:
        """Strength at a time after the ramp's end, and its standard error."""
        predictions = self._holds.predict(at_s=at_s)
        log_weight = self._prior - predictions.misfit * predictions.spare / 2
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        value = float(weight @ predictions.values)
        variance = float(weight @ (predictions.stderr**2 + (predictions.values - value) ** 2))
        return value, float(np.sqrt(variance))
