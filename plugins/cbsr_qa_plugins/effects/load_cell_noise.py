"""Noise of the load cell."""

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.streams import RandomStream


class LoadCellNoise:
    """Independent Gaussian noise on every force sample.

    Parameters
    ----------
    rms_N : standard deviation [N].
    """

    needs: tuple[str, ...] = ()
    perturbs = "force"

    def __init__(self, setting: SceneSetting, *, rms_N: float) -> None:
        self._rms_N = number("rms_N", rms_N)
        self._stream = RandomStream(setting.seed, "load-cell-noise")

    def apply(self, moment: Moment) -> None:
        """Add the sample's noise."""
        moment.force_N += self._rms_N * float(self._stream.normal(moment.index))
