"""Readings in steps of a converter."""

import numpy as np

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number, whole
from cbsr_qa_plugins.effects._converter import BEFORE_CONVERSION


class Quantisation:
    """Every reading is rounded to the nearest step of a converter.

    A step is 2 × range / 2^bits.

    Parameters
    ----------
    range_V : of the converter, to both sides.
    bits : of the converter.
    """

    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = BEFORE_CONVERSION
    perturbs = "voltages"

    def __init__(self, setting: SceneSetting, *, range_V: float, bits: int) -> None:
        self._step_V = 2 * number("range_V", range_V, above=True) / 2 ** whole("bits", bits, least=4, most=32)

    def apply(self, moment: Moment) -> None:
        """Round."""
        if moment.voltages is not None:
            moment.voltages = self._step_V * np.round(moment.voltages / self._step_V)
