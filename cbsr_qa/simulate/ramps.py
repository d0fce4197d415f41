"""Linear viscoelasticity of presses: hereditary integrals over linear ramps, exactly.

A quantity that answers a unit step of strain with K(t) answers the history ε(t) with ∫ K(t − s) ε̇(s) ds
(Boltzmann superposition). A press is a few linear ramps, so the integral is a sum of closed forms: no time step,
no memory between frames, and any moment can be asked for in any order.
"""

import math
from collections.abc import Iterator
from typing import Final

from cbsr_qa.domain.scene import SimulatedPress, StrainStep
from cbsr_qa.domain.sensor import QuasiStatic, Relaxation

#: Strain over which the intercept of a quasi-static line fades in: one step of the surface search, 0.05 mm of 4 mm.
#: Below it the fitted line says nothing, and without load there is no response.
CONTACT_STRAIN: Final = 0.0125


def done(ramp: StrainStep, time_s: float) -> float:
    """Return how much of a ramp is over at a time, 0 to 1."""
    since = time_s - ramp.start_s
    if since >= ramp.ramp_s:
        return 1.0
    return since / ramp.ramp_s if since > 0 else 0.0


def transient(ramp: StrainStep, relaxation: Relaxation, time_s: float) -> float:
    """Return what has not yet relaxed of a unit ramp: Σ wᵢ/T ∫ e^(−(t − s)/τᵢ) ds over the ramp up to t.

    Together with :func:`done` it is the hereditary integral of 1 + w₁ e^(−t/τ₁) + w₂ e^(−t/τ₂) over the ramp.
    """
    since = time_s - ramp.start_s
    if since <= 0:
        return 0.0
    past = since - min(since, ramp.ramp_s)  # since the ramp's end
    total = 0.0
    for weight, tau in zip(relaxation.weights, relaxation.time_constants_s, strict=True):
        length = (since - past) / tau
        # expm1 keeps a ramp of no length a step: (1 − e^(−x))/x → 1.
        share = -math.expm1(-length) / length if length > 0 else 1.0
        total += weight * math.exp(-past / tau) * share
    return total * done(ramp, time_s)


def response_ramps(press: SimulatedPress, line: QuasiStatic) -> Iterator[tuple[bool, StrainStep]]:
    """Turn a press's strain ramps into ramps of the quasi-static change α ε + β.

    The intercept β fades in over the first :data:`CONTACT_STRAIN` of strain, so each ramp is split there: the
    change stays linear in time within a piece.

    Yields
    ------
    (whether the head presses harder, the ramp of the change).
    """
    slope, intercept = line.slope.value, line.intercept.value
    if not intercept:
        yield from ((s.change > 0, StrainStep(s.start_s, s.ramp_s, slope * s.change)) for s in press.steps)
        return
    strain = 0.0
    for step in press.steps:
        for piece in _split(step, strain):
            rise = _contact(strain + piece.change) - _contact(strain)
            strain += piece.change
            yield piece.change > 0, StrainStep(piece.start_s, piece.ramp_s, slope * piece.change + intercept * rise)


def released(press: SimulatedPress, line: QuasiStatic, kernel: Relaxation, time_s: float) -> float:
    """Return what has not yet relaxed of all ramps of the quasi-static change that lift."""
    ramps = response_ramps(press, line)
    return sum(ramp.change * transient(ramp, kernel, time_s) for loads, ramp in ramps if not loads)


def _contact(strain: float) -> float:
    return min(max(strain / CONTACT_STRAIN, 0.0), 1.0)


def _split(step: StrainStep, strain: float) -> Iterator[StrainStep]:
    to_contact = (CONTACT_STRAIN - strain) / step.change if step.change else 0.0
    if not 0 < to_contact < 1:
        yield step
        return
    yield StrainStep(step.start_s, step.ramp_s * to_contact, step.change * to_contact)
    rest = 1 - to_contact
    yield StrainStep(step.start_s + step.ramp_s * to_contact, step.ramp_s * rest, step.change * rest)
