"""A scene as a recording: heads press its loads, then its frames and samples are taken."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.scene_plan import PressTimes, SceneLoad, ScenePlan, press_times, stroke_points
from cbsr_qa.domain.plan.steps import distance_mm, travel_s
from cbsr_qa.domain.plan.world import SimulatedPress, Transcript
from cbsr_qa.domain.readings.frames import FrameBlock, Recording, SampleBlock, ScanKind, VoltageUnit
from cbsr_qa.domain.readings.loads import Load, LoadRecord
from cbsr_qa.simulate.head import SimulatedHead
from cbsr_qa.simulate.world import SimulatedWorld
from cbsr_qa.system.clock import VirtualClock

#: Number of addresses of a head's movements; those of head n start at n − 1 times this number.
HEAD_BLOCK: Final = 1 << 24


@dataclass(frozen=True, slots=True)
class PressedLoad:
    """A pressed load.

    Parameters
    ----------
    index : position in the scene's list, from 0.
    record : what a rig would note: commanded place and depth, and times.
    press : press that acts on the sheet; None if the head did not reach the true surface.
    """

    index: int
    load: SceneLoad
    record: LoadRecord
    press: SimulatedPress | None

    @property
    def true_strain(self) -> float:
        """Deepest true strain: the sheet may be off nominal, and heads may err."""
        if self.press is None:
            return 0.0
        return max(self.press.strain_at(step.start_s + step.ramp_s) for step in self.press.steps)


def press_loads(world: SimulatedWorld, plan: ScenePlan, end_s: float) -> tuple[PressedLoad, ...]:
    """Let every head of a scene press its loads, each on its own clock.

    Returns them in the scene's order. RefusedError if a load strains the true sheet by 100 % or more. ``world``:
    presses are appended to its list, those of head 1 first.
    """
    pressed: list[PressedLoad] = []
    for number, loads in plan.heads().items():
        pressed += _press_loads(world, plan, number, loads, end_s)
    for load in pressed:
        if load.true_strain >= 1:
            raise RefusedError(
                f"loads[{load.index + 1}] would strain the sheet by {100 * load.true_strain:.0f} %: where it is"
                " pressed the sheet lies higher or is thinner than nominal",
                remedy="press less deep, or use effects on sheet and head that leave more thickness",
            )
    return tuple(sorted(pressed, key=lambda load: load.index))


def _press_loads(
    world: SimulatedWorld, plan: ScenePlan, number: int, loads: tuple[SceneLoad, ...], end_s: float
) -> list[PressedLoad]:
    clock = VirtualClock()
    first_index = (number - 1) * HEAD_BLOCK
    head = SimulatedHead(clock, world, plan.motion, role=f"head {number}", first_index=first_index)
    thickness_mm = world.setting.sensor_type.thickness_mm
    pressed = []
    for load in loads:
        times = press_times(load, load.strain * thickness_mm, plan.motion)
        press_count = len(world.presses)
        head.travel(load.x_mm, load.y_mm)
        clock.sleep(times.leaves_s - clock.now())
        head.press(load.strain * thickness_mm, plan.motion.press_speed_mm_s)
        clock.sleep(times.lifts_s - clock.now())
        head.lift()
        press = world.presses[press_count] if len(world.presses) > press_count else None
        index = next(index for index, other in enumerate(plan.loads) if other is load)
        pressed.append(PressedLoad(index, load, _record(index, load, times, end_s), press))
    return _end_rests(pressed)


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


def _end_rests(pressed: list[PressedLoad]) -> list[PressedLoad]:
    """End each rest where the same head's next press begins."""
    rested = [
        replace(load, record=replace(load.record, rest_end_s=following.record.press_start_s))
        for load, following in pairwise(pressed)
    ]
    return [*rested, *pressed[-1:]]


def head_path(plan: ScenePlan, thickness_mm: float, time_s: Array) -> tuple[SampleBlock, ...]:
    """Commanded position of head 1 at some times: x, y from the sheet's centre and z over the hover height [mm].

    As in the rig's CSV: z falls from 0, and is −hover at the nominal surface. Between presses the head moves on at
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
        SampleBlock(name, "mm", time_s, np.interp(time_s, at_s, axis_mm))
        for name, axis_mm in zip(("x", "y", "z"), axes, strict=True)
    )


#: Samples of force and place per second: of the rig's load cell; a power of two, so that their times are exact.
SAMPLE_RATE_HZ: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class RecordedScene:
    """A recorded scene.

    Parameters
    ----------
    transcript : recorded rows, and pauses of a board.
    """

    recording: Recording
    transcript: Transcript
    pressed: tuple[PressedLoad, ...]

    @property
    def frames_lost(self) -> int:
        """Frames with at least one lost row."""
        return int(self.transcript.lost.any(axis=1).sum())


def frame_middles_s(plan: ScenePlan) -> Array:
    """Middles of the frames of a board that never pauses, (frames,) [s]."""
    return (np.arange(plan.frame_count, dtype=np.float64) + 0.5) * plan.scene.frame_period_s


def frame_times_s(transcript: Transcript) -> tuple[Array, Array]:
    """Times of frames from a board that pauses.

    A frame's time is its planned middle plus the board's pauses up to the row in its middle (the ninth of 16, the
    first one read after it): a dump before that row delays the frame, a later one only the rest of its rows. Returns
    (frames,) times, and (frames, drives) delays of rows relative to their frame's time [s], negative for rows read
    before a dump in the frame's first half.
    """
    pauses_s = transcript.pauses_s()
    middle_s = pauses_s[:, pauses_s.shape[1] // 2]
    return transcript.time_s + middle_s, pauses_s - middle_s[:, None]


def record_scene(
    world: SimulatedWorld, plan: ScenePlan, *, progress: Callable[[int, int], None] = lambda done, of: None
) -> RecordedScene:
    """Press a scene's loads and record it.

    Everything is addressed (frames by their number, force samples by theirs) and done one after the other, so that
    the same scene and seed give the same bytes everywhere. RefusedError if a load strains the sheet by 100 % or more,
    or an effect leaves an unsolvable sheet. ``progress``: called with the numbers of frames taken and in total.
    """
    transcript = world.transcript(frame_middles_s(plan))
    paused_s = sum(dump.pause_s for dump in transcript.dumps)
    end_s = plan.frame_count * plan.scene.frame_period_s + paused_s
    pressed = press_loads(world, plan, end_s)
    cell = _LoadCell(world, end_s)

    def report_progress(done: int, of: int) -> None:
        cell.read_up_to(done / of)  # along with the frames: they take most of the time of slow frames
        progress(done, of)

    frames = _frames(world, transcript, report_progress)
    samples = cell.samples(plan)
    recording = Recording(
        path=Path(),
        format="cbsr-recording",
        dataset="",
        scan=ScanKind.FULL,
        frames=frames,
        reference=None,
        still=False,
        magnitudes_only=False,
        clock="station",
        samples=samples,
        loads=tuple(sorted((load.record for load in pressed), key=lambda record: record.press_start_s)),
        layout=world.setting.sensor_type.electrodes,
        sensor_type=world.setting.sensor_type.name,
    )
    return RecordedScene(recording, transcript, pressed)


def _frames(world: SimulatedWorld, transcript: Transcript, progress: Callable[[int, int], None]) -> FrameBlock:
    times_s, row_pauses_s = frame_times_s(transcript)
    frames = []
    for index, (time_s, pauses_s) in enumerate(zip(times_s.tolist(), row_pauses_s, strict=True)):
        frames.append(world.frame(time_s, index, pauses_s))
        progress(index + 1, len(times_s))
    reading_times_s = [frame.time_s for frame in frames if frame.time_s is not None]
    return FrameBlock(
        times_s,
        np.stack([frame.voltages for frame in frames]),
        np.stack([frame.flags for frame in frames]),
        VoltageUnit.VOLT,
        world.setting.current_A,
        np.stack(reading_times_s) if reading_times_s else None,
    )


class _LoadCell:
    """Force on the load cell, shared by all heads, from zero to the end."""

    def __init__(self, world: SimulatedWorld, end_s: float) -> None:
        self._world = world
        self._time_s = np.arange(int(end_s * SAMPLE_RATE_HZ + 1e-9) + 1) / SAMPLE_RATE_HZ
        self._force_N = np.empty_like(self._time_s)
        self._count = 0

    def read_up_to(self, share: float) -> None:
        """Take the samples up to a share of the recording."""
        end = math.ceil(share * len(self._time_s))
        for number in range(self._count, end):
            self._force_N[number] = self._world.force_N(float(self._time_s[number]), number)
        self._count = end

    def samples(self, plan: ScenePlan) -> tuple[SampleBlock, ...]:
        cell = SampleBlock("force", "N", self._time_s, self._force_N)
        return (cell, *head_path(plan, self._world.setting.sensor_type.thickness_mm, self._time_s))
