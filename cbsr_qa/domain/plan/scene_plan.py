"""A scene recorded without a station: sensor, loads, duration."""

from dataclasses import dataclass
from typing import Final

from cbsr_qa.domain.plan.plan import Motion, Scene
from cbsr_qa.domain.plan.steps import CLEARANCE_MM, lift_off_s, stroke_s
from cbsr_qa.domain.readings.loads import Indenter

#: The rig's press speed of 40 mm/min and hover height; 600 mm/min between places is chosen by us, as in the shipped
#: station.
RIG_MOTION: Final = Motion(press_speed_mm_s=40 / 60, travel_speed_mm_s=10.0, hover_mm=25.0)
RIG_HEAD: Final = Indenter(13.0)
#: Longest recording, in frames: with 16 electrodes its voltages take 200 MB.
MOST_FRAMES: Final = 100_000


@dataclass(frozen=True, slots=True)
class SceneLoad:
    """One load of a scene.

    Parameters
    ----------
    x_mm, y_mm : axis of the head, from the sheet's centre.
    strain : depth below the nominal surface over the nominal thickness, as a fraction.
    start_s : time at which the head touches the nominal surface [s].
    hold_s : time that the head stays once it is down [s].
    head : number of the head that presses, from 1.
    """

    x_mm: float
    y_mm: float
    strain: float
    start_s: float
    hold_s: float
    head: int = 1

    @property
    def place_mm(self) -> tuple[float, float]:
        return self.x_mm, self.y_mm


@dataclass(frozen=True, slots=True)
class ScenePlan:
    """Content of a scene file; a station uses only its :class:`~cbsr_qa.domain.plan.plan.Scene`.

    Parameters
    ----------
    scene : current, mesh and effects.
    sensor_type, material : names of files; None if the station states them.
    indenter, motion : indenter and motion of every head.
    seed, duration_s : seed and duration of the recording; None if the scene has none.
    loads : loads in the order of the file.
    """

    scene: Scene
    sensor_type: str | None = None
    material: str | None = None
    indenter: Indenter = RIG_HEAD
    motion: Motion = RIG_MOTION
    seed: int | None = None
    duration_s: float | None = None
    loads: tuple[SceneLoad, ...] = ()

    @property
    def frame_count(self) -> int:
        """Whole frames that fit into the recording; 0 if it has no duration."""
        return 0 if self.duration_s is None else int(self.duration_s / self.scene.frame_period_s + 1e-9)

    def heads(self) -> dict[int, tuple[SceneLoad, ...]]:
        """Loads of each head by its number, in pressing order."""
        numbers = sorted({load.head for load in self.loads})
        by_time = sorted(self.loads, key=lambda load: load.start_s)
        return {number: tuple(load for load in by_time if load.head == number) for number in numbers}


@dataclass(frozen=True, slots=True)
class PressTimes:
    """Schedule of a head, on the scene's clock [s].

    Parameters
    ----------
    leaves_s : time at which it leaves the hover height [s].
    touches_s, down_s, lifts_s, clear_s : times at which it touches the nominal surface, is down, goes up and has left
        the surface [s].
    up_s : time at which it is at the hover height again [s].
    """

    leaves_s: float
    touches_s: float
    down_s: float
    lifts_s: float
    clear_s: float
    up_s: float


def press_times(load: SceneLoad, depth_mm: float, motion: Motion) -> PressTimes:
    """Schedule of one load, pressed to a depth below the nominal surface."""
    down_s = load.start_s + depth_mm / motion.press_speed_mm_s
    lifts_s = down_s + load.hold_s
    return PressTimes(
        leaves_s=load.start_s - approach_s(motion),
        touches_s=load.start_s,
        down_s=down_s,
        lifts_s=lifts_s,
        clear_s=lifts_s + lift_off_s(motion, depth_mm),
        up_s=lifts_s + stroke_s(motion, depth_mm),
    )


def approach_s(motion: Motion) -> float:
    """Time from the hover height to the nominal surface [s]."""
    return stroke_s(motion, 0.0)


def stroke_points(times: PressTimes, depth_mm: float, motion: Motion) -> tuple[tuple[float, float], ...]:
    """Corners (time [s], height over the hover height [mm], falling from 0) of a head's way down and up again."""
    slow_mm = min(CLEARANCE_MM, motion.hover_mm)
    near_mm, slow_s = slow_mm - motion.hover_mm, slow_mm / motion.press_speed_mm_s
    return (
        (times.leaves_s, 0.0),
        (times.touches_s - slow_s, near_mm),
        (times.down_s, -motion.hover_mm - depth_mm),
        (times.lifts_s, -motion.hover_mm - depth_mm),
        (times.clear_s + slow_s, near_mm),
        (times.up_s, 0.0),
    )
