"""A stored run as a recording that ``analyse`` reads."""

from dataclasses import dataclass, replace
from pathlib import Path

from cbsr_qa.analysis import write_recording
from cbsr_qa.config import database_url
from cbsr_qa.domain import RefusedError
from cbsr_qa.domain.readings import Recording, SampleBlock, ScanKind, join_frames, join_samples
from cbsr_qa.domain.results import CommandOutcome
from cbsr_qa.domain.run import PhaseRecord, RunRecord, VerdictOverride
from cbsr_qa.report import answer, plural
from cbsr_qa.store import open_store


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written."""

    run: str
    recording: Path
    frames: int
    loads: int
    overrides: tuple[VerdictOverride, ...]


def export_run(run_or_serial: str, to: Path, *, phase: str | None, database: str | None) -> CommandOutcome[Exported]:
    """Write frames, samples and presses of a stored run to one file.

    Parameters
    ----------
    run_or_serial : a run, or a serial number for its latest run.

    Raises
    ------
    RefusedError
        If the file exists already, the run has no frames, or it has no such phase.
    StoreError
        If there is no such run.
    """
    if to.exists():
        raise RefusedError(f"{to} exists already", remedy="name another file, or remove it first")
    with open_store(database_url(database), create=False) as store:
        record = store.load_run(store.resolve(run_or_serial))
        overrides = store.overrides(record.identity.run)
    recording = as_recording(record, to, record.phases if phase is None else (record.phase(phase),))
    notes = tuple(f"the verdict was {override.words}" for override in overrides)
    recording = replace(recording, notes=(*recording.notes, *notes))
    write_recording(to, recording)
    identity = record.identity
    exported = Exported(identity.run, to, len(recording.frames), len(recording.loads), overrides)
    frames, presses = plural(exported.frames, "frame"), plural(exported.loads, "press", "presses")
    facts = (("Run", identity.words),)
    return answer(exported, "exported", f"{frames} and {presses}", facts, printed=(("Recording", str(to)),))


def as_recording(record: RunRecord, path: Path, phases: tuple[PhaseRecord, ...]) -> Recording:
    """Join phases of a run into one recording. RefusedError if they hold no frame."""
    blocks = [phase.frames for phase in phases if phase.frames is not None and len(phase.frames)]
    if not blocks:
        raise RefusedError(
            f"run {record.identity.run} of sensor {record.identity.sensor.serial} holds no frames in"
            f" {', '.join(p.name for p in phases)}"
        )
    notes = [f"run {record.identity.run} of sensor {record.identity.sensor.serial}"]
    if loops := sum(len(phase.loops) for phase in phases):
        notes.append(f"not among its presses, which are of one strain each: loops through several strains ({loops})")
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
        samples=_samples(phases),
        loads=tuple(load for phase in phases for load in phase.loads),
        layout=record.sensor_type.electrodes,
        sensor_type=record.sensor_type.name,
        notes=tuple(notes),
        simulated=record.identity.simulated,
    )


def _samples(phases: tuple[PhaseRecord, ...]) -> tuple[SampleBlock, ...]:
    channels: dict[str, list[SampleBlock]] = {}
    for phase in phases:
        for block in phase.samples:
            channels.setdefault(block.channel, []).append(block)
    return tuple(join_samples(blocks) for blocks in channels.values())
