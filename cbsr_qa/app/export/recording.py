"""Phases of a stored run as a recording that ``analyse`` reads."""

from pathlib import Path

from cbsr_qa.app.export.frames import joined_samples, no_frames
from cbsr_qa.domain.readings import Recording, ScanKind, join_frames
from cbsr_qa.domain.run import PhaseRecord, RunRecord, VerdictOverride


def as_recording(
    record: RunRecord, path: Path, phases: tuple[PhaseRecord, ...], overrides: tuple[VerdictOverride, ...] = ()
) -> Recording:
    """Join phases of a run into one recording. RefusedError if they hold no frame."""
    blocks = [phase.frames for phase in phases if phase.frames is not None and len(phase.frames)]
    if not blocks:
        raise no_frames(record, phases)
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
        samples=joined_samples(phases),
        loads=tuple(load for phase in phases for load in phase.loads),
        layout=record.sensor_type.electrodes,
        sensor_type=record.sensor_type.name,
        notes=tuple(notes),
        simulated=record.identity.simulated,
    )
