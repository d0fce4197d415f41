"""What a station allows a step to ask for. The dry run lists every broken rule; the runner stops at the first."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain.loads import Load
from cbsr_qa.runner.plan import Plan

#: Sums of durations are compared with this much room: below the resolution of any clock after hours [s].
_ROUNDING_S: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Violation:
    """A rule a step would break.

    Parameters
    ----------
    rule : ``"strain"``, ``"force"``, ``"travel"``, ``"dwell"``, ``"duration"`` or ``"order"``.
    what : what is asked for and what is allowed.
    """

    rule: str
    what: str


def place_violations(x_mm: float, y_mm: float, plan: Plan) -> Iterator[Violation]:
    """Yield what is wrong with a place: out of the head's range, or the head not wholly on the sheet."""
    radius_mm = math.hypot(x_mm, y_mm)
    if not radius_mm <= plan.safety.travel_radius_mm:
        yield Violation(
            "travel", f"{radius_mm:.4g} mm from the centre; the station allows {plan.safety.travel_radius_mm:g} mm"
        )
    if plan.sensor_type.polygon is None:
        yield from _off_disc(radius_mm, plan)
    else:
        yield from _off_polygon(x_mm, y_mm, plan)


def _off_disc(radius_mm: float, plan: Plan) -> Iterator[Violation]:
    head_mm, sheet_mm = plan.indenter.reach_mm, plan.sensor_type.radius_mm
    if not radius_mm + head_mm <= sheet_mm:
        yield Violation(
            "travel",
            f"the head of {2 * head_mm:g} mm would reach {radius_mm + head_mm:.4g} mm; the sheet ends at"
            f" {sheet_mm:g} mm",
        )


def _off_polygon(x_mm: float, y_mm: float, plan: Plan) -> Iterator[Violation]:
    head_mm = plan.indenter.reach_mm
    room_mm = float(plan.sensor_type.outline.clearance_mm(np.array([[x_mm, y_mm]]))[0])
    if not room_mm >= head_mm and not _stands_on(x_mm, y_mm, plan):
        where = f"{room_mm:.4g} mm from the sheet's edge" if room_mm >= 0 else f"{-room_mm:.4g} mm outside the sheet"
        yield Violation(
            "travel", f"the head of {2 * head_mm:g} mm would stand {where}; it needs {head_mm:g} mm inside it"
        )


def _stands_on(x_mm: float, y_mm: float, plan: Plan) -> bool:
    """Whether a head with corners stands on the sheet with all of its outline, its edge included.

    A head may be as wide as a strip, and be turned as the strip is. The outline is looked at every 0.25 mm.
    """
    corners = np.array(plan.indenter.outline_mm)
    if not len(corners):
        return False
    ahead = np.roll(corners, -1, axis=0)
    steps = [max(math.ceil(math.dist(a, b) / 0.25), 1) for a, b in zip(corners, ahead, strict=True)]
    edges = [np.linspace(a, b, count, endpoint=False) for a, b, count in zip(corners, ahead, steps, strict=True)]
    clearance_mm = plan.sensor_type.outline.clearance_mm(np.vstack(edges) + np.array([x_mm, y_mm]))
    return bool((clearance_mm >= -1e-9).all())


def load_violations(load: Load, plan: Plan) -> Iterator[Violation]:
    """Yield what is wrong with a load: its place, its strain, the force it is expected to take."""
    yield from place_violations(load.x_mm, load.y_mm, plan)
    yield from strain_violations(load.strain, plan)


def strain_violations(strain: float, plan: Plan) -> Iterator[Violation]:
    """Yield what is wrong with a strain, wherever it is pressed: itself, the force it is expected to take."""
    if not 0 < strain <= plan.safety.strain:
        yield Violation(
            "strain", f"{100 * strain:.4g} % strain; the station allows up to {100 * plan.safety.strain:g} %"
        )
    force_N = expected_force_N(strain, plan)
    if not force_N <= plan.safety.force_N:
        yield Violation("force", f"{force_N:.3g} N expected; the station allows {plan.safety.force_N:g} N")


def dwell_violations(dwell_s: float, plan: Plan) -> Iterator[Violation]:
    """Yield what is wrong with a head that has been down, and still or eased, for this long."""
    if not dwell_s <= plan.safety.dwell_s + _ROUNDING_S:
        allowed_s = plan.safety.dwell_s
        yield Violation("dwell", f"the head is down for {dwell_s:.4g} s; the station allows {allowed_s:g} s")


def expected_force_N(strain: float, plan: Plan) -> float:
    """Return the highest force a press is expected to take [N].

    E ε A is the relaxed force (E of the material file is the relaxed modulus); at the end of a fast ramp the
    relaxing terms stand on top of it: F = E ε A (1 + Σ max(w, 0)), an upper bound for any mixture of signs.
    """
    relaxed_N = plan.material.modulus_kPa.value * 1e-3 * strain * plan.indenter.area_mm2
    return relaxed_N * (1 + sum(max(weight, 0.0) for weight in plan.material.stress_relaxation.weights))
