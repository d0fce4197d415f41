"""What a load leaves behind."""

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.domain.sensor import Relaxation
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.ramps import Transients


class Residue:
    """A share of every change stays when it is released, and fades slowly.

    Residues of earlier loads (paper 4.2), beside the relaxation of the material itself: ramps that lift are answered
    with −share e^(−t/τ) more.

    Parameters
    ----------
    share : of the released change.
    decay_s : τ, minutes and more.
    """

    needs: tuple[str, ...] = ("piezoresistivity",)
    perturbs = "response"

    def __init__(self, setting: SceneSetting, *, share: float, decay_s: float) -> None:
        decay_s = number("decay_s", decay_s, above=True)
        kernel = Relaxation((-number("share", share, most=1.0), 0.0), (decay_s, decay_s), "scene")
        self._transients = Transients(None, kernel, setting.material.against_strain)
        self.memory_s = self._transients.memory_s

    def apply(self, moment: Moment) -> None:
        """Add what is left of every press."""
        for index, press in enumerate(moment.presses):
            moment.response[index] += self._transients.of(press, moment.time_s)
