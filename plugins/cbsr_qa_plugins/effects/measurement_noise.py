"""Noise of the voltage readings."""

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.streams import RandomStream


class MeasurementNoise:
    """Independent Gaussian noise, equal on all readings of the frame.

    Parameters
    ----------
    relative_noise : rms of one reading over the mean magnitude of the used readings of the unloaded sheet; by
        default the material's.
    """

    needs: tuple[str, ...] = ()
    perturbs = "voltages"

    def __init__(self, setting: SceneSetting, *, relative_noise: float | None = None) -> None:
        relative = setting.material.relative_noise.value if relative_noise is None else relative_noise
        if not 0 <= relative < float("inf"):
            raise ConfigError(f"relative_noise is {relative}", remedy="it is a finite number of at least 0")
        self._relative = relative
        self._stream = RandomStream(setting.seed, "measurement-noise")

    def apply(self, moment: Moment) -> None:
        """Add the frame's noise."""
        if moment.voltages is not None:
            rms_V = self._relative * moment.reading_scale_V
            moment.voltages = moment.voltages + rms_V * self._stream.normal(moment.index, moment.voltages.shape)
