"""Readings of a frame are taken one after the other."""

import numpy as np

from cbsr_qa.clock import TICK_S
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number


class TimeSkew:
    """The readings of a frame are taken one after the other instead of all at once.

    Reading n of N at (n + ½)/N of the part of the frame that is spent reading, about its middle.

    Parameters
    ----------
    share : of the frame's period that is spent reading.
    inner : which pair steps faster, ``"measure"`` (row by row) or ``"drive"`` (the rig's command multiplexer).
    """

    needs: tuple[str, ...] = ()
    perturbs = "times"

    def __init__(self, setting: SceneSetting, *, share: float = 1.0, inner: str = "measure") -> None:
        if inner not in ("measure", "drive"):
            raise ConfigError(f"inner is {inner!r}", remedy="it is 'measure' or 'drive'")
        drives, measures = setting.sensor_type.pattern.shape
        count = np.arange(drives * measures, dtype=np.float64)
        order = count.reshape(drives, measures) if inner == "measure" else count.reshape(measures, drives).T
        spent_s = number("share", share, most=1.0) * setting.frame_period_s
        # In the clock's ticks: whatever rests on differences of times is then the same at any time of a run.
        self._offsets_s = TICK_S * np.rint(((order + 0.5) / order.size - 0.5) * spent_s / TICK_S)

    def apply(self, moment: Moment) -> None:
        """Give every reading its time."""
        moment.reading_offsets_s = self._offsets_s
