"""Noise of the readings so far, cheap enough for a display."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.steps import AcquireFrames, Press, Release
from cbsr_qa.domain.readings.frames import UNUSABLE, FrameBlock
from cbsr_qa.domain.run.events import FramesTaken, RunEvent, StepStarted

#: Fewest degrees of freedom that give a figure.
_LEAST: Final = 5


class NoiseSoFar:
    """A subscriber that computes the noise of frames in steps :class:`AcquireFrames` with the head up.

    Variances are pooled over steps, each about its own mean: a drift between steps is no noise. Frames during a
    rest after a press are left out, since the sheet still recovers in them.
    """

    def __init__(self) -> None:
        self._counts = self._pressed = False
        self._frames = 0
        self._freedom = 0
        self._mean: Array | None = None
        self._squares: Array | None = None
        self._unusable: NDArray[np.bool_] | None = None

    def __call__(self, event: RunEvent) -> None:
        match event:
            case StepStarted(step=step):
                if isinstance(step, Press | Release):
                    self._pressed = isinstance(step, Press)
                self._counts = isinstance(step, AcquireFrames) and not self._pressed
                self._frames = 0
            case FramesTaken(frames=frames) if self._counts:
                self._add(frames)

    @property
    def percent(self) -> float | None:
        """Median over readings of the standard deviation of a frame, in per cent of the reading; None if unknown."""
        if self._freedom < _LEAST or self._squares is None or self._mean is None or self._unusable is None:
            return None
        is_used = ~self._unusable & (self._mean != 0)
        if not is_used.any():
            return None
        deviation = np.sqrt(self._squares[is_used] / self._freedom)
        return float(100 * np.median(deviation / np.abs(self._mean[is_used])))

    def _add(self, frames: FrameBlock) -> None:
        for voltages, flags in zip(frames.voltages, frames.flags & UNUSABLE, strict=True):
            if self._mean is None or self._squares is None or self._unusable is None:
                self._squares, self._unusable = np.zeros_like(voltages), np.zeros(voltages.shape, dtype=bool)
            self._unusable |= flags != 0
            if not self._frames or self._mean is None:
                self._mean, self._frames = voltages.copy(), 1
                continue
            self._frames += 1
            self._freedom += 1
            step = voltages - self._mean
            self._mean = self._mean + step / self._frames
            self._squares += step * (voltages - self._mean)


def relative_drift(frames: FrameBlock, usable: NDArray[np.bool_]) -> float:
    """Drift between the halves of some frames, as a share of the noise of one frame.

    Both are root mean squares over the usable readings; noise comes from successive frames, and what it adds to the
    difference of two means is taken off. 0 where the difference is no more than that; infinite without noise, or
    without a usable reading.

    Parameters
    ----------
    usable : (drives, measures) bool.
    """
    counted = usable & ~(frames.flags & UNUSABLE).any(axis=0)
    if not counted.any():
        return float("inf")
    voltages = frames.voltages[:, counted]
    half = len(voltages) // 2
    squared = ((voltages[half:].mean(axis=0) - voltages[:half].mean(axis=0)) ** 2).sum()
    noise = (np.diff(voltages, axis=0) ** 2).mean(axis=0).sum() / 2
    excess = squared - noise * (1 / half + 1 / (len(voltages) - half))
    if excess <= 0:
        return 0.0
    return float(np.sqrt(excess / noise)) if noise > 0 else float("inf")
