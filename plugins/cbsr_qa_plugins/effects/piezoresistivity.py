"""Quasi-static piezoresistivity: the sheet's conductance follows the strain under the head."""

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.ramps import quasi_static


class Piezoresistivity:
    """The sheet's conductance under the head follows the strain along the material's quasi-static line.

    Δρ/ρ₀ = α_ε ε + β_ε (paper Eq 2), with the material's α_ε and β_ε. The paper fits the line to held loads; β_ε is
    the line's value where nothing presses, which cannot be. Here it fades in over the first contact
    (:data:`cbsr_qa.simulate.ramps.CONTACT_STRAIN`) and goes with it.
    """

    needs: tuple[str, ...] = ()
    perturbs = "response"
    memory_s = 0.0

    def __init__(self, setting: SceneSetting) -> None:
        self._line = setting.material.against_strain

    def apply(self, moment: Moment) -> None:
        """Add the quasi-static change of every press."""
        for number, press in enumerate(moment.presses):
            moment.response[number] += quasi_static(self._line, press.strain_at(moment.time_s))
