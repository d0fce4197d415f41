"""An electrode that is noisier than the others."""

import numpy as np

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate import parameters
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.streams import RandomStream


class ElectrodeNoise:
    """Independent Gaussian noise on every reading that uses an electrode, to drive, to measure or both.

    It adds to that of other effects. Readings that use the electrode twice have no more of it than the others.

    Parameters
    ----------
    electrode : its number.
    relative_noise : rms on one reading over the mean magnitude of the used readings of the unloaded sheet, as of
        ``measurement-noise``.
    """

    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = ("voltmeter-input",)
    perturbs = "voltages"

    def __init__(self, setting: SceneSetting, *, electrode: int, relative_noise: float) -> None:
        which = parameters.electrode("electrode", electrode, setting.sensor_type.electrodes.count)
        pattern = setting.sensor_type.pattern
        drives, measures = (np.array([which in pair for pair in pairs]) for pairs in (pattern.drive, pattern.measure))
        self._relative = number("relative_noise", relative_noise) * (drives[:, None] | measures)
        self._stream = RandomStream(setting.seed, "electrode-noise")

    def apply(self, moment: Moment) -> None:
        """Add the frame's noise."""
        if moment.voltages is not None:
            rms_V = self._relative * moment.reading_scale_V
            moment.voltages = moment.voltages + rms_V * self._stream.normal(moment.index, moment.voltages.shape)
