"""Relaxation of the conductance after each press and each release."""

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.ramps import Transients


class ConductanceRelaxation:
    """The conductance change nears its held value by two exponentials after every press and every release.

    Paper Eq 3, superposed over all ramps. Every ramp of the quasi-static change q(t) is answered with K(t) = 1 + w₁
    e^(−t/τ₁) + w₂ e^(−t/τ₂), by the material's loading kernel where the head presses harder and by its unloading
    kernel where it lifts: Δρ/ρ₀(t) = Σ over ramps ∫ K(t − s) q̇(s) ds. Piezoresistivity is the 1 of K; this effect
    adds the rest. Negative weights creep towards the steady state. After a release they leave a residue that fades,
    which later loads meet (paper 4.2).

    Departure from linear viscoelasticity: two kernels, since the paper finds unloading slower than loading.
    """

    needs: tuple[str, ...] = ("piezoresistivity",)
    perturbs = "response"

    def __init__(self, setting: SceneSetting) -> None:
        material = setting.material
        self._transients = Transients(
            material.loading_relaxation, material.unloading_relaxation, material.against_strain
        )
        self.memory_s = self._transients.memory_s

    def apply(self, moment: Moment) -> None:
        """Add what has not yet relaxed of every press."""
        for number, press in enumerate(moment.presses):
            moment.response[number] += self._transients.of(press, moment.time_s)
