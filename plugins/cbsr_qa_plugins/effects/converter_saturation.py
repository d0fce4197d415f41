"""A converter that ends."""

import numpy as np

from cbsr_qa.domain.frames import ReadingFlag
from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number
from cbsr_qa_plugins.effects._converter import BEFORE_CONVERSION


class ConverterSaturation:
    """Readings beyond the converter's range are its end, and flagged as saturated.

    Parameters
    ----------
    range_V : to both sides.
    """

    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = BEFORE_CONVERSION
    perturbs = "voltages"

    def __init__(self, setting: SceneSetting, *, range_V: float) -> None:
        self._range_V = number("range_V", range_V, above=True)

    def apply(self, moment: Moment) -> None:
        """Clip and flag."""
        if moment.voltages is not None and moment.flags is not None:
            beyond = np.abs(moment.voltages) >= self._range_V
            moment.voltages = np.clip(moment.voltages, -self._range_V, self._range_V)
            moment.flags |= np.where(beyond, np.uint8(ReadingFlag.SATURATED), np.uint8(0))
