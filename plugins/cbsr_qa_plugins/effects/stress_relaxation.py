"""Stress relaxation of the sheet: a generalised Maxwell body with two terms."""

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.ramps import Transients


class StressRelaxation:
    """The stress under a held head relaxes by two exponentials: a generalised Maxwell body.

    σ(t) = E ∫ (1 + w₁ e^(−(t−s)/τ₁) + w₂ e^(−(t−s)/τ₂)) ε̇(s) ds (paper Eq 3 over its steady state). The elastic
    effect is the 1 of the kernel; this effect adds the rest. Right after a release the sheet would pull on a head
    that stuck to it; the head does not stick, so the world reads no negative stress.
    """

    needs: tuple[str, ...] = ("elastic-stress",)
    perturbs = "stress"

    def __init__(self, setting: SceneSetting) -> None:
        self._modulus_kPa = setting.material.modulus_kPa.value
        kernel = setting.material.stress_relaxation
        self._transients = Transients(kernel, kernel)

    def apply(self, moment: Moment) -> None:
        """Add what has not yet relaxed of every press."""
        for number, press in enumerate(moment.presses):
            moment.stress_kPa[number] += self._modulus_kPa * self._transients.of(press, moment.time_s)
