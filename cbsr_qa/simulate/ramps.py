"""Linear viscoelasticity of presses: hereditary integrals over linear ramps, exactly.

A quantity with the step response K(t) to strain responds to the history ε(t) with ∫ K(t − s) ε̇(s) ds (Boltzmann
superposition). A press is a few linear ramps, so the integral is a sum of closed forms: no time step, no memory
between frames, and moments can be computed in any order.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from cbsr_qa.domain.plan.world import SimulatedPress, StrainRamp
from cbsr_qa.domain.sensor.sensor_type import QuasiStatic, Relaxation

#: Relative change below which a press is forgotten; a hundredth of the smallest change solved for.
FORGOTTEN: Final = 1e-9

#: Strain over which the intercept of a quasi-static line fades in: one step of the surface search, 0.05 mm of 4 mm.
#: At smaller strains the fitted line is meaningless, and without load there is no response.
CONTACT_STRAIN: Final = 0.0125


def ramp_share(ramp: StrainRamp, time_s: float) -> float:
    """Return the completed share of a ramp at a time, 0 to 1."""
    since = time_s - ramp.start_s
    if since >= ramp.ramp_s:
        return 1.0
    return since / ramp.ramp_s if since > 0 else 0.0


def transient(ramp: StrainRamp, relaxation: Relaxation, time_s: float) -> float:
    """Return the transient of a unit ramp: Σ wᵢ/T ∫ e^(−(t − s)/τᵢ) ds over the ramp up to t.

    Together with :func:`ramp_share` it is the hereditary integral of 1 + w₁ e^(−t/τ₁) + w₂ e^(−t/τ₂) over the ramp.
    """
    since_s = time_s - ramp.start_s
    if since_s <= 0:
        return 0.0
    past_s = since_s - min(since_s, ramp.ramp_s)  # since the ramp's end
    total = 0.0
    for weight, tau in zip(relaxation.weights, relaxation.time_constants_s, strict=True):
        total += weight * math.exp(-past_s / tau) * _share((since_s - past_s) / tau)
    return total * ramp_share(ramp, time_s)


def response_ramps(press: SimulatedPress, line: QuasiStatic) -> Iterator[tuple[bool, StrainRamp]]:
    """Turn a press's strain ramps into ramps of the quasi-static change α ε + β.

    The intercept β fades in over the first :data:`CONTACT_STRAIN` of strain, so each ramp is split there: the
    change stays linear in time within a piece.

    Yields
    ------
    (whether the head presses harder, the ramp of the change).
    """
    slope, intercept = line.slope.value, line.intercept.value
    if not intercept:
        yield from ((s.change > 0, StrainRamp(s.start_s, s.ramp_s, slope * s.change)) for s in press.steps)
        return
    strain = 0.0
    for step in press.steps:
        for piece in _split(step, strain):
            rise = _contact(strain + piece.change) - _contact(strain)
            strain += piece.change
            yield piece.change > 0, StrainRamp(piece.start_s, piece.ramp_s, slope * piece.change + intercept * rise)


def quasi_static(line: QuasiStatic, strain: float) -> float:
    """Return α ε + β with the intercept faded in, see :func:`response_ramps`."""
    return line.slope.value * strain + line.intercept.value * _contact(strain)


class Transients:
    """Transients of presses.

    While a press moves its ramps are added up one by one; after its end they are one exponential per time constant,
    with cached amplitudes, since most presses of a run are over.

    Parameters
    ----------
    loading, lifting : kernels for ramps on which the head presses harder, and on which it lifts, or None.
    line : turns ramps of strain into ramps of the quasi-static change; None to use those of strain.
    """

    def __init__(
        self, loading: Relaxation | None, lifting: Relaxation | None, line: QuasiStatic | None = None
    ) -> None:
        self._kernels = {True: loading, False: lifting}
        self._line = line
        self._known: dict[int, _Over] = {}

    @property
    def memory_s(self) -> float:
        """Time after a press beyond which less than :data:`FORGOTTEN` of it remains, for any strain [s]."""
        largest = 1.0 if self._line is None else abs(self._line.slope.value) + abs(self._line.intercept.value)
        kernels = [kernel for kernel in self._kernels.values() if kernel is not None]
        terms = [part for kernel in kernels for part in zip(kernel.weights, kernel.time_constants_s, strict=True)]
        durations_s = [tau * math.log(max(abs(w) * largest * len(terms) / FORGOTTEN, 1.0)) for w, tau in terms]
        return max(durations_s, default=0.0)

    def change_at(self, press: SimulatedPress, time_s: float) -> float:
        if not press.steps or time_s <= press.steps[0].start_s:
            return 0.0
        ramp_sums = self._known.get(press.index)
        if ramp_sums is None or ramp_sums.press is not press or ramp_sums.steps != len(press.steps):
            ramp_sums = self._known[press.index] = self._sum_ramps(press)
        since_s = time_s - ramp_sums.end_s
        if since_s >= 0:
            return sum([amplitude * math.exp(-since_s / tau_s) for amplitude, tau_s in ramp_sums.terms])
        return sum([ramp.change * transient(ramp, kernel, time_s) for ramp, kernel in ramp_sums.ramps])

    def _sum_ramps(self, press: SimulatedPress) -> "_Over":
        ramps = response_ramps(press, self._line) if self._line else ((s.change > 0, s) for s in press.steps)
        answered = [(ramp, kernel) for loads, ramp in ramps if (kernel := self._kernels[loads])]
        end_s = max(step.start_s + step.ramp_s for step in press.steps)
        amplitude_by_tau: dict[float, float] = {}
        for ramp, kernel in answered:
            past_s = end_s - (ramp.start_s + ramp.ramp_s)
            for weight, tau in zip(kernel.weights, kernel.time_constants_s, strict=True):
                remaining_share = weight * math.exp(-past_s / tau) * _share(ramp.ramp_s / tau)
                amplitude_by_tau[tau] = amplitude_by_tau.get(tau, 0.0) + ramp.change * remaining_share
        return _Over(
            press, len(press.steps), end_s, answered, [(start, tau) for tau, start in amplitude_by_tau.items()]
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Over:
    """A press of many steps: its ramps with their kernels, and their remainder after its end."""

    press: SimulatedPress
    steps: int
    end_s: float
    ramps: list[tuple[StrainRamp, Relaxation]]
    terms: list[tuple[float, float]]


def _share(length: float) -> float:
    """Return (1 − e^(−x))/x, which makes a ramp of zero length a step."""
    return -math.expm1(-length) / length if length > 0 else 1.0


def _contact(strain: float) -> float:
    return min(max(strain / CONTACT_STRAIN, 0.0), 1.0)


def _split(step: StrainRamp, strain: float) -> Iterator[StrainRamp]:
    to_contact = (CONTACT_STRAIN - strain) / step.change if step.change else 0.0
    if not 0 < to_contact < 1:
        yield step
        return
    yield StrainRamp(step.start_s, step.ramp_s * to_contact, step.change * to_contact)
    loaded_share = 1 - to_contact
    yield StrainRamp(step.start_s + step.ramp_s * to_contact, step.ramp_s * loaded_share, step.change * loaded_share)
