"""Documents of a resumed session on the clock of the whole run."""

from dataclasses import fields, replace

from cbsr_qa.domain.frames import FrameBlock, SampleBlock
from cbsr_qa.domain.loads import LoadRecord
from cbsr_qa.domain.run_events import FramesTaken, LoadFinished, RunEvent, RunStarted, SamplesTaken, StepRetried


def shifted(event: RunEvent, offset_s: float) -> RunEvent:
    """Return a document with every time in it later by an offset [s]."""
    if not offset_s:
        return event
    match event:
        case RunStarted() | StepRetried():
            return event
        case FramesTaken(frames=frames):
            return replace(event, frames=_frames(frames, offset_s))
        case SamplesTaken(samples=samples):
            return replace(event, samples=_samples(samples, offset_s))
        case LoadFinished(record=record):
            return replace(event, record=_load(record, offset_s))
        case _:
            return replace(event, time_s=event.time_s + offset_s)


def _frames(block: FrameBlock, offset_s: float) -> FrameBlock:
    own = None if block.reading_time_s is None else block.reading_time_s + offset_s
    return replace(block, time_s=block.time_s + offset_s, reading_time_s=own)


def _samples(block: SampleBlock, offset_s: float) -> SampleBlock:
    return replace(block, time_s=block.time_s + offset_s)


def _load(record: LoadRecord, offset_s: float) -> LoadRecord:
    times = {f.name: getattr(record, f.name) for f in fields(record) if f.name.endswith("_s")}
    eased = tuple(
        replace(one, start_s=one.start_s + offset_s, hold_start_s=one.hold_start_s + offset_s) for one in record.eased
    )
    later = {name: time_s + offset_s for name, time_s in times.items() if time_s is not None}
    return replace(record, **later, eased=eased)
