"""The heads of a scene that is recorded by itself: they press its loads before the first frame is taken."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.clock import VirtualClock
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.frames import SampleBlock
from cbsr_qa.domain.kinematics import distance_mm, travel_s
from cbsr_qa.domain.loads import Load, LoadRecord
from cbsr_qa.domain.scene import SimulatedPress
from cbsr_qa.domain.scene_plan import PressTimes, SceneLoad, ScenePlan, press_times, stroke_points
from cbsr_qa.simulate.head import SimulatedHead
from cbsr_qa.simulate.world import SimulatedWorld

#: Movements of a head, the addresses of their random numbers, are counted from this multiple of its number less one.
HEAD_BLOCK: Final = 1 << 24


@dataclass(frozen=True, slots=True)
class PressedLoad:
    """A load as it was pressed.

    Parameters
    ----------
    index : in the scene's list, from 0.
    record : as a rig would have noted it: where and how deep its head was told to go, and when it did.
    press : what the sheet had of it; None where the head did not reach the true surface.
    """

    index: int
    load: SceneLoad
    record: LoadRecord
    press: SimulatedPress | None

    @property
    def true_strain(self) -> float:
        """Deepest true strain: the sheet may lie off nominal, and heads may err."""
        if self.press is None:
            return 0.0
        return max(self.press.strain_at(step.start_s + step.ramp_s) for step in self.press.steps)


def press_loads(world: SimulatedWorld, plan: ScenePlan, end_s: float) -> tuple[PressedLoad, ...]:
    """Let every head of a scene press its loads, each on a clock of its own.

    Parameters
    ----------
    world : presses are appended to its list, those of head 1 first.
    plan : whose loads were found to be possible.
    end_s : when the last rest is over.

    Returns
    -------
    In the scene's order.

    Raises
    ------
    RefusedError
        If a load strains the sheet, as it truly lies and is, by 100 % or more.
    """
    pressed: list[PressedLoad] = []
    for number, loads in plan.heads().items():
        pressed += _pressed_by(world, plan, number, loads, end_s)
    for one in pressed:
        if one.true_strain >= 1:
            raise RefusedError(
                f"loads[{one.index + 1}] would strain the sheet by {100 * one.true_strain:.0f} %: where it is pressed"
                " the sheet lies higher or is thinner than nominal",
                remedy="press it less deep, or take effects on the sheet and the head that leave more",
            )
    return tuple(sorted(pressed, key=lambda one: one.index))


def _pressed_by(
    world: SimulatedWorld, plan: ScenePlan, number: int, loads: tuple[SceneLoad, ...], end_s: float
) -> list[PressedLoad]:
    clock = VirtualClock()
    first = (number - 1) * HEAD_BLOCK
    head = SimulatedHead(clock, world, plan.motion, role=f"head {number}", first_index=first)
    thickness_mm = world.setting.sensor_type.thickness_mm
    pressed = []
    for load in loads:
        times = press_times(load, load.strain * thickness_mm, plan.motion)
        before = len(world.presses)
        head.travel(load.x_mm, load.y_mm)
        clock.sleep(times.leaves_s - clock.now())
        head.press(load.strain * thickness_mm, plan.motion.press_speed_mm_s)
        clock.sleep(times.lifts_s - clock.now())
        head.lift()
        made = world.presses[before] if len(world.presses) > before else None
        index = next(index for index, one in enumerate(plan.loads) if one is load)
        pressed.append(PressedLoad(index, load, _record(index, load, times, end_s), made))
    return _rested(pressed)


def _record(index: int, load: SceneLoad, times: PressTimes, rest_end_s: float) -> LoadRecord:
    return LoadRecord(
        index,
        Load(f"L{index}", load.x_mm, load.y_mm, load.strain, 0),
        press_start_s=times.leaves_s,
        hold_start_s=times.down_s,
        release_start_s=times.lifts_s,
        release_end_s=times.up_s,
        rest_end_s=rest_end_s,
        clear_s=times.clear_s,
    )


def _rested(pressed: list[PressedLoad]) -> list[PressedLoad]:
    """Let each rest end where the same head's next press begins."""
    rested = [
        replace(one, record=replace(one.record, rest_end_s=following.record.press_start_s))
        for one, following in pairwise(pressed)
    ]
    return [*rested, *pressed[-1:]]


def head_path(plan: ScenePlan, thickness_mm: float, time_s: NDArray[np.float64]) -> tuple[SampleBlock, ...]:
    """Where head 1 was told to be at some times: x, y from the sheet's centre and z over the hover height [mm].

    As in the rig's CSV: z falls from 0, and is −hover at the nominal surface. Between presses the head goes on at
    once and waits over the next place; without a load it stays over the centre.
    """
    corners = [(0.0, 0.0, 0.0, 0.0)]
    for load in plan.heads().get(1, ()):
        depth_mm = load.strain * thickness_mm
        free_s, *place, _ = corners[-1]
        there_s = free_s + travel_s(plan.motion, distance_mm((place[0], place[1]), load.place_mm))
        corners.append((there_s, *load.place_mm, 0.0))
        times = press_times(load, depth_mm, plan.motion)
        corners += [(at_s, *load.place_mm, z_mm) for at_s, z_mm in stroke_points(times, depth_mm, plan.motion)]
    at_s, *axes = np.array(corners).T
    return tuple(
        SampleBlock(name, "mm", time_s, np.interp(time_s, at_s, along))
        for name, along in zip(("x", "y", "z"), axes, strict=True)
    )
