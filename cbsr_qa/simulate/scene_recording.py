"""A scene's frames and samples, one after the other, as a recording."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.frames import FrameBlock, SampleBlock, VoltageUnit
from cbsr_qa.domain.recording import Recording, ScanKind
from cbsr_qa.domain.scene import Transcript
from cbsr_qa.domain.scene_plan import ScenePlan
from cbsr_qa.simulate.scene_heads import PressedLoad, head_path, press_loads
from cbsr_qa.simulate.world import SimulatedWorld

Array = NDArray[np.float64]

#: Samples of force and place a second: of the rig's load cell; a power of two, so that their times are exact.
SAMPLE_RATE_HZ: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class RecordedScene:
    """A scene that was recorded.

    Parameters
    ----------
    recording : all frames, also those of which rows are lost.
    transcript : which rows those are, and where a board paused.
    pressed : every load, in the scene's order.
    """

    recording: Recording
    transcript: Transcript
    pressed: tuple[PressedLoad, ...]

    @property
    def frames_lost(self) -> int:
        """Frames of which at least one row is lost."""
        return int(self.transcript.lost.any(axis=1).sum())


def planned_middles_s(plan: ScenePlan) -> Array:
    """Middles of the frames of a board that never pauses, (frames,) [s]."""
    middles: Array = (np.arange(plan.frame_count, dtype=np.float64) + 0.5) * plan.scene.frame_period_s
    return middles


def frame_times_s(transcript: Transcript) -> tuple[Array, Array]:
    """When frames are taken by a board that pauses.

    A frame's time is its planned middle and what the board had paused up to the row in the frame's middle (of 16 rows
    the ninth, the first that is read after it): a dump before that row makes the frame itself late, one behind it
    only the rest of its rows.

    Returns
    -------
    (frames,) times of the frames, and (frames, drives) how much later than with its frame's time each row is read,
    [s]; below zero for rows that were read before a dump in the frame's first half.
    """
    pauses_s = transcript.pauses_s()
    middle_s = pauses_s[:, pauses_s.shape[1] // 2]
    return transcript.time_s + middle_s, pauses_s - middle_s[:, None]


def record_scene(
    world: SimulatedWorld, plan: ScenePlan, *, progress: Callable[[int, int], None] = lambda done, of: None
) -> RecordedScene:
    """Press a scene's loads and record it.

    Everything is addressed (frames by their number, force samples by theirs) and done one after the other, so that
    the same scene and seed give the same bytes everywhere.

    Parameters
    ----------
    world : of the scene, with no press on it yet.
    plan : whose loads were found to be possible.
    progress : told how many frames of how many are taken.

    Raises
    ------
    RefusedError
        If a load strains the sheet by 100 % or more, or an effect leaves nothing that can be solved.
    """
    transcript = world.transcript(planned_middles_s(plan))
    paused_s = sum(dump.pause_s for dump in transcript.dumps)
    end_s = plan.frame_count * plan.scene.frame_period_s + paused_s
    pressed = press_loads(world, plan, end_s)
    cell = _LoadCell(world, end_s)

    def taken(done: int, of: int) -> None:
        cell.read_up_to(done / of)  # along with the frames: of slow frames they take most of the time
        progress(done, of)

    frames = _frames(world, transcript, taken)
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
        loads=tuple(sorted((one.record for one in pressed), key=lambda record: record.press_start_s)),
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
    own = [one.time_s for one in frames if one.time_s is not None]
    return FrameBlock(
        times_s,
        np.stack([one.voltages for one in frames]),
        np.stack([one.flags for one in frames]),
        VoltageUnit.VOLT,
        world.setting.current_A,
        np.stack(own) if own else None,
    )


class _LoadCell:
    """Force on the load cell, which all heads share, from zero to the end."""

    def __init__(self, world: SimulatedWorld, end_s: float) -> None:
        self._world = world
        self._time_s = np.arange(int(end_s * SAMPLE_RATE_HZ + 1e-9) + 1) / SAMPLE_RATE_HZ
        self._force_N = np.empty_like(self._time_s)
        self._count = 0

    def read_up_to(self, share: float) -> None:
        """Take the samples of a share of the recording that are not taken yet."""
        end = math.ceil(share * len(self._time_s))
        for number in range(self._count, end):
            self._force_N[number] = self._world.force_N(float(self._time_s[number]), number)
        self._count = end

    def samples(self, plan: ScenePlan) -> tuple[SampleBlock, ...]:
        """All of them, and the way of head 1."""
        cell = SampleBlock("force", "N", self._time_s, self._force_N)
        return (cell, *head_path(plan, self._world.setting.sensor_type.thickness_mm, self._time_s))
