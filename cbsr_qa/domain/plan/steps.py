"""Steps of a sequence. The runner executes them; a dry run only checks them.

Also the head's travel times from a station's motion, for the dry run.

Speeds are taken as constant: at the rig's 200 mm/s² reaching 10 mm/s costs 0.05 s a move, under 1 % of a cycle.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from cbsr_qa.domain.plan.plan import Motion
from cbsr_qa.domain.readings.loads import Load


class Role(StrEnum):
    """Purpose of a sequence: metrics and report sections look for roles, never for a plugin's name."""

    NOISE = "noise"  #: unloaded frames and centre loads for the noise figure
    GRID = "grid"  #: fixed places at common strains
    RANDOM = "random"  #: places and strains drawn at random
    RELAXATION = "relaxation"  #: long holds for relaxation fits
    PRECONDITIONING = "preconditioning"  #: presses that work the sheet in before anything is measured
    CHARACTERISATION = "characterisation"  #: press cycles on a strip of the material
    LOOP = "loop"  #: strains reached from below and from above without lifting the head between
    OTHER = "other"


@dataclass(frozen=True, slots=True)
class Home:
    """Find the applicator's zero."""


@dataclass(frozen=True, slots=True)
class FindSurface:
    """Step down at a place until the contact force, and remember the zero-strain height there."""

    x_mm: float
    y_mm: float


@dataclass(frozen=True, slots=True)
class TouchPlane(FindSurface):
    """Find the surface at a place as one of three or more of a plane; presses at places not found go by the plane.

    Parameters
    ----------
    tolerance_mm : largest distance from the plane of a further touch, and of the contact of a press.
    """

    tolerance_mm: float


@dataclass(frozen=True, slots=True)
class LowerHover:
    """From here to the end of the phase, lift the head no higher than this above the highest point of the surface.

    Parameters
    ----------
    clearance_mm : from what the station allows to the hover height.
    """

    clearance_mm: float


@dataclass(frozen=True, slots=True)
class Press:
    """Travel to a load's place and press to its strain at press speed."""

    load: Load


@dataclass(frozen=True, slots=True)
class StrainStep:
    """Bring the pressed head to another strain at the same place, deeper or less deep, without leaving the sheet.

    Moves at the press speed. A press with several strains is one load: it is stored, and repeated after an
    interruption, as a whole.

    Parameters
    ----------
    strain : compressive, as a fraction; above 0.
    """

    strain: float


@dataclass(frozen=True, slots=True)
class Hold:
    """Wait, pressed or not.

    Parameters
    ----------
    acquire : whether frames are taken meanwhile.
    """

    hold_s: float
    acquire: bool


@dataclass(frozen=True, slots=True)
class Settle(Hold):
    """Rest, taking frames, until the readings drift no more, for ``hold_s`` at most.

    Parameters
    ----------
    least_s : the rest is not shorter.
    drift : of the readings over half of a window, as a share of the noise of one frame, below which it ends.
    """

    least_s: float
    drift: float


@dataclass(frozen=True, slots=True)
class Release:
    """Lift the head to the hover height."""


@dataclass(frozen=True, slots=True)
class AcquireFrames:
    """Take a number of frames."""

    count: int


@dataclass(frozen=True, slots=True)
class MarkUnloaded:
    """Mark the sheet as rested: frames from here to the next press are reference and noise."""


@dataclass(frozen=True, slots=True)
class Prompt:
    """Ask the operator to do something and wait for the answer. ``picture``: path of an image to show with it."""

    text: str
    picture: str = ""


Step = Home | FindSurface | LowerHover | Press | StrainStep | Hold | Release | AcquireFrames | MarkUnloaded | Prompt


#: Height above a surface below which the head moves at its press speed, as the surface may be higher than expected.
CLEARANCE_MM: Final = 0.2
#: The surface search begins this far above the nominal surface,
SEARCH_FROM_MM: Final = 0.5
#: goes down in the rig's steps of 0.05 mm,
SEARCH_STEP_MM: Final = 0.05
#: this many of them in contact, so that zero force can be extrapolated,
SEARCH_CONTACT_STEPS: Final = 3
#: and waits after each for the load cell [s].
SEARCH_DWELL_S: Final = 0.25
#: Least distance from a line of the places touched for a plane (root mean square): with 5 mm an error of 0.01 mm of a
#: touch tilts the plane by less than 0.1 mm over 40 mm.
LEAST_SPREAD_MM: Final = 5.0
#: Frames of the window over which a step ``Settle`` looks for a drift.
SETTLE_FRAMES: Final = 12


def travel_s(motion: Motion, distance_mm: float) -> float:
    """Time to travel at the hover height [s]."""
    return distance_mm / motion.travel_speed_mm_s


def homing_s(motion: Motion, reach_mm: float) -> float:
    """Time to find the zero of all axes [s]: the station's own, or up and across from the end of the head's reach."""
    if motion.homing_s is not None:
        return motion.homing_s
    return travel_s(motion, motion.hover_mm + reach_mm)


def stroke_s(motion: Motion, depth_mm: float) -> float:
    """Time between the hover height and a depth, either way: fast in free air, at press speed near the sheet [s]."""
    slow_mm = min(CLEARANCE_MM, motion.hover_mm)
    return (motion.hover_mm - slow_mm) / motion.travel_speed_mm_s + (slow_mm + depth_mm) / motion.press_speed_mm_s


def ease_s(motion: Motion, from_mm: float, to_mm: float) -> float:
    """Time between two depths within the sheet, either way, at the press speed [s]."""
    return abs(to_mm - from_mm) / motion.press_speed_mm_s


def lift_off_s(motion: Motion, depth_mm: float) -> float:
    """Time the head needs to leave the sheet from a depth, going up at the press speed [s]."""
    return depth_mm / motion.press_speed_mm_s


def surface_search_s(motion: Motion) -> float:
    """Time to search the surface from the hover height and return [s]."""
    steps = SEARCH_FROM_MM / SEARCH_STEP_MM + SEARCH_CONTACT_STEPS
    stepping_s = steps * (SEARCH_STEP_MM / motion.press_speed_mm_s + SEARCH_DWELL_S)
    approach_mm = max(motion.hover_mm - SEARCH_FROM_MM, 0.0)
    return (
        approach_mm / motion.travel_speed_mm_s + stepping_s + stroke_s(motion, SEARCH_CONTACT_STEPS * SEARCH_STEP_MM)
    )


def distance_mm(start: tuple[float, float], end: tuple[float, float]) -> float:
    """Straight distance between two places [mm]."""
    return math.dist(start, end)


def spread_mm(places_mm: Sequence[tuple[float, float]]) -> float:
    """Root mean square distance of places from the line nearest to them [mm]; 0 with fewer than three."""
    count = len(places_mm)
    if count < 3:
        return 0.0
    x_mean, y_mean = sum(x for x, _ in places_mm) / count, sum(y for _, y in places_mm) / count
    xx = sum((x - x_mean) ** 2 for x, _ in places_mm) / count
    yy = sum((y - y_mean) ** 2 for _, y in places_mm) / count
    xy = sum((x - x_mean) * (y - y_mean) for x, y in places_mm) / count
    smallest = (xx + yy) / 2 - math.hypot((xx - yy) / 2, xy)  # eigenvalue of their covariance
    return math.sqrt(max(smallest, 0.0))
