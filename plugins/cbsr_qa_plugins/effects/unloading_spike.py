"""The conductance jumps the wrong way when the head lifts."""

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.domain.sensor import Relaxation
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.ramps import Transients


class UnloadingSpike:
    """A release first raises the change by some share of what it will take away, and that fades.

    Paper 3.1.2. At the moment of a release the material's unloading kernel keeps −Σ w of what is released
    (`conductance-relaxation`). Every ramp that lifts is also answered with −(1 + size + Σ w) e^(−t/τ): at once the
    change is `size` of the ramp beyond where it was, and comes back to the material's own curve with τ. The paper
    prints neither: both are to be chosen.

    Parameters
    ----------
    size : of the spike over the change that is released.
    decay_s : τ.
    """

    needs: tuple[str, ...] = ("piezoresistivity", "conductance-relaxation")
    perturbs = "response"

    def __init__(self, setting: SceneSetting, *, size: float, decay_s: float) -> None:
        decay_s = number("decay_s", decay_s, above=True)
        kept = -sum(setting.material.unloading_relaxation.weights)
        kernel = Relaxation((kept - 1 - number("size", size, most=2.0), 0.0), (decay_s, decay_s), "scene")
        self._transients = Transients(None, kernel, setting.material.against_strain)
        self.memory_s = self._transients.memory_s

    def apply(self, moment: Moment) -> None:
        """Add the spikes of every press that is being lifted, or was."""
        for index, press in enumerate(moment.presses):
            moment.response[index] += self._transients.of(press, moment.time_s)
