"""Elastic stress under the head."""

from cbsr_qa.domain.scene import Moment, SceneSetting


class ElasticStress:
    """The sheet resists the head with a stress in proportion to the strain, by the material's relaxed modulus.

    σ = E ε: uniaxial compression, no confinement under the head.
    """

    needs: tuple[str, ...] = ()
    perturbs = "stress"

    def __init__(self, setting: SceneSetting) -> None:
        self._modulus_kPa = setting.material.modulus_kPa.value

    def apply(self, moment: Moment) -> None:
        """Add the elastic stress of every press."""
        for number, press in enumerate(moment.presses):
            moment.stress_kPa[number] += self._modulus_kPa * press.strain_at(moment.time_s)
