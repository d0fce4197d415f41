"""Frames of a run with what was going on at each: phase, press, place, strain; or as a recording."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.frames import (
    FrameBlock,
    ReadingFlag,
    Recording,
    SampleBlock,
    ScanKind,
    join_frames,
    join_samples,
)
from cbsr_qa.domain.readings.loads import LoadRecord
from cbsr_qa.domain.run.changes import VerdictOverride
from cbsr_qa.domain.run.run import PhaseRecord, RunRecord


class LoadStage(IntEnum):
    """What the head was doing."""

    NONE = 0  #: nothing that is recorded as a press held to its end
    PRESS = 1  #: it moves down
    HOLD = 2
    EASE = 3  #: it moves to another strain without leaving the sheet
    RELEASE = 4  #: it moves up
    REST = 5  #: it is up, and the sheet recovers


@dataclass(frozen=True, slots=True, eq=False)
class RunFrames:
    """Frames of some phases of a run, in order.

    Parameters
    ----------
    frames : n frames; ``current_A`` is None where it is not the same for all.
    current_A : (n,) drive current [A]; NaN where not stated.
    phase : (n,) index into ``phases``.
    load : (n,) index into ``loads``; −1 where none is in progress.
    stage : (n,) uint8 of :class:`LoadStage`.
    strain : (n,) compressive strain as a fraction, NaN except in HOLD.
    phases, loads : names of the phases; presses, each with the index of its phase.
    """

    frames: FrameBlock
    current_A: Array
    phase: NDArray[np.int32]
    load: NDArray[np.int32]
    stage: NDArray[np.uint8]
    strain: Array
    phases: tuple[str, ...]
    loads: tuple[tuple[int, LoadRecord], ...]

    def load_values(self, value: str) -> NDArray[Any]:
        """Return a field of :class:`~cbsr_qa.domain.readings.loads.Load` for each frame.

        Returns
        -------
        (n,) float64 with NaN, or object with empty text, where no press is in progress.
        """
        values = [getattr(record.load, value) for _, record in self.loads]
        absent = "" if value == "label" else np.nan
        kind = object if value == "label" else np.float64
        return np.array([*values, absent], dtype=kind)[self.load]

    @property
    def readings(self) -> Array:
        """Readings (n, drives, measures) in their unit, NaN where a reading is missing."""
        missing = self.frames.flags & ReadingFlag.MISSING.value != 0
        return np.where(missing, np.nan, self.frames.voltages)


def run_frames(record: RunRecord, phases: tuple[PhaseRecord, ...]) -> RunFrames:
    """Return the frames of some phases of a run that count.

    Raises
    ------
    RefusedError
        If they hold no frame, or differ in the unit or shape of their frames.
    """
    measured = [(p, p.frames) for p in phases if p.frames is not None and len(p.frames)]
    if not measured:
        raise missing_frames_error(record, phases)
    return frames_of(
        [
            (phase.name, frames, sorted((*phase.loads, *phase.loops), key=lambda load: load.index))
            for phase, frames in measured
        ]
    )


def frames_of(measured: Sequence[tuple[str, FrameBlock, Sequence[LoadRecord]]]) -> RunFrames:
    """Join named blocks of frames, each with its presses. Raises as :func:`run_frames`."""
    loads = tuple((n, load) for n, (_, _, phase_loads) in enumerate(measured) for load in phase_loads)
    frame_counts = [len(frames) for _, frames, _ in measured]
    phase_indices = np.repeat(np.arange(len(measured), dtype=np.int32), frame_counts)
    currents = [np.nan if frames.current_A is None else frames.current_A for _, frames, _ in measured]
    frames = _join_blocks([frames for _, frames, _ in measured])
    return RunFrames(
        frames,
        np.repeat(np.array(currents, dtype=np.float64), frame_counts),
        phase_indices,
        *_assign_loads(frames.time_s, phase_indices, loads),
        tuple(name for name, _, _ in measured),
        loads,
    )


def missing_frames_error(record: RunRecord, phases: tuple[PhaseRecord, ...]) -> RefusedError:
    """Return the refusal of phases without a frame."""
    names = ", ".join(phase.name for phase in phases) or "any phase"
    return RefusedError(
        f"run {record.identity.run} of sensor {record.identity.sensor.serial} holds no frames in {names}"
    )


def join_channels(phases: tuple[PhaseRecord, ...]) -> tuple[SampleBlock, ...]:
    """Return the samples of each channel, of all phases together."""
    channels: dict[str, list[SampleBlock]] = {}
    for phase in phases:
        for block in phase.samples:
            channels.setdefault(block.channel, []).append(block)
    return tuple(join_samples(blocks) for blocks in channels.values())


def _join_blocks(blocks: list[FrameBlock]) -> FrameBlock:
    """Join blocks that may differ in current, or in whether each reading's own time was recorded."""
    current_A = blocks[0].current_A if len({block.current_A for block in blocks}) == 1 else None
    if any(block.reading_time_s is not None for block in blocks):
        blocks = [
            replace(block, reading_time_s=np.full(block.voltages.shape, np.nan))
            if block.reading_time_s is None
            else block
            for block in blocks
        ]
    try:
        return join_frames([replace(block, current_A=current_A) for block in blocks])
    except RefusedError as error:
        raise RefusedError(
            "phases of this run differ in the unit or the shape of their frames",
            remedy="export one phase at a time with --phase",
        ) from error


def _assign_loads(
    time_s: Array, phase: NDArray[np.int32], loads: tuple[tuple[int, LoadRecord], ...]
) -> tuple[NDArray[np.int32], NDArray[np.uint8], Array]:
    """Return load, stage and strain of each frame."""
    number = np.full(len(time_s), -1, dtype=np.int32)
    stage = np.zeros(len(time_s), dtype=np.uint8)
    strain = np.full(len(time_s), np.nan)
    for n, (own_phase, load) in enumerate(loads):
        eased_steps = load.eased
        moves_s = [moment for step in eased_steps for moment in (step.start_s, step.hold_start_s)]
        ends_s = (load.release_start_s, load.release_end_s, load.rest_end_s)
        stage_indices = np.searchsorted(
            [load.press_start_s, load.hold_start_s, *moves_s, *ends_s], time_s, side="right"
        )
        begins = [LoadStage.PRESS, LoadStage.HOLD, *[LoadStage.EASE, LoadStage.HOLD] * len(eased_steps)]
        stages = np.array(
            [LoadStage.NONE, *begins, LoadStage.RELEASE, LoadStage.REST, LoadStage.NONE], dtype=np.uint8
        )
        strains = np.full(len(stages), np.nan)
        strains[stages == LoadStage.HOLD] = [held.strain for held in load.held]
        during_load_mask = (phase == own_phase) & (stages[stage_indices] != LoadStage.NONE)
        number[during_load_mask] = n
        stage[during_load_mask] = stages[stage_indices][during_load_mask]
        strain[during_load_mask] = strains[stage_indices][during_load_mask]
    return number, stage, strain


def as_recording(
    record: RunRecord, path: Path, phases: tuple[PhaseRecord, ...], overrides: tuple[VerdictOverride, ...] = ()
) -> Recording:
    """Join phases of a run into one recording. Raise RefusedError if they hold no frame."""
    blocks = [phase.frames for phase in phases if phase.frames is not None and len(phase.frames)]
    if not blocks:
        raise missing_frames_error(record, phases)
    notes = [f"run {record.identity.run} of sensor {record.identity.sensor.serial}"]
    if loops := sum(len(phase.loops) for phase in phases):
        notes.append(f"not among its presses, which are of one strain each: loops through several strains ({loops})")
    notes += [f"the verdict was {override.words}" for override in overrides]
    return Recording(
        path=path,
        format="cbsr-recording",
        dataset="",
        scan=ScanKind.FULL,
        frames=join_frames(blocks),
        reference=None,
        still=False,
        magnitudes_only=False,
        clock="computer",
        samples=join_channels(phases),
        loads=tuple(load for phase in phases for load in phase.loads),
        layout=record.sensor_type.electrodes,
        sensor_type=record.sensor_type.name,
        serial=record.identity.sensor.serial,
        notes=tuple(notes),
        simulated=record.identity.simulated,
    )
