"""How long the head takes, as a station's motion tells: the dry run counts with it, the simulated head obeys it."""

import math
from typing import Final

from cbsr_qa.domain.plan import Motion

#: Finding the zero of all axes, as a Cartesian stage does it [s].
HOMING_S: Final = 20.0


def travel_s(motion: Motion, distance_mm: float) -> float:
    """Time to travel at the hover height [s]."""
    return distance_mm / motion.travel_speed_mm_s


def press_s(motion: Motion, depth_mm: float) -> float:
    """Time from the hover height to a depth: to the surface at travel speed, then at press speed [s]."""
    return motion.hover_mm / motion.travel_speed_mm_s + depth_mm / motion.press_speed_mm_s


def release_s(motion: Motion, depth_mm: float) -> float:
    """Time from a depth back to the hover height, at travel speed [s]."""
    return (motion.hover_mm + depth_mm) / motion.travel_speed_mm_s


def surface_s(motion: Motion) -> float:
    """Time to feel for the surface from the hover height, and to come back [s]."""
    return motion.hover_mm / motion.press_speed_mm_s + motion.hover_mm / motion.travel_speed_mm_s


def distance_mm(start: tuple[float, float], end: tuple[float, float]) -> float:
    """Straight distance between two places [mm]."""
    return math.dist(start, end)
