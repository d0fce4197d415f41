"""The journal: commits every event of a run before it is reported elsewhere.

Times of a resumed session are shifted onto the clock of the whole run, after the last stored one.
"""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, fields, replace
from functools import singledispatchmethod
from typing import Any, Final

from sqlalchemy import Connection, Engine, func, select
from sqlalchemy.orm import InstrumentedAttribute

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.readings.loads import Indenter, LoadRecord
from cbsr_qa.domain.run.attendance import AttendanceEvent, PromptAnswered, PromptShown, RunContinued, RunPaused
from cbsr_qa.domain.run.events import (
    FramesTaken,
    LoadFinished,
    PhaseFinished,
    PhaseStarted,
    RunEnded,
    RunEvent,
    RunStarted,
    SamplesTaken,
    StepRetried,
    StepStarted,
    Unloaded,
)
from cbsr_qa.domain.run.gate import GateAnswer
from cbsr_qa.domain.run.run import PressDecided, RunIdentity
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.sensor_type import Material, SensorType
from cbsr_qa.store.chain.links import add_rows
from cbsr_qa.store.engine import writing
from cbsr_qa.store.mapping import row_of
from cbsr_qa.store.runs.attendance import attendance_values
from cbsr_qa.store.runs.codec import encode_setting, frame_values, sample_block, sample_values
from cbsr_qa.store.runs.configuration_changes import note_changes
from cbsr_qa.store.runs.gate_answers import add_answers
from cbsr_qa.store.runs.rows import begin_run, current_state, phases_of, run_row
from cbsr_qa.store.tables.runs import (
    AttendanceRow,
    DecisionRow,
    FrameBlockRow,
    LoadRow,
    PhaseEndRow,
    PhaseRow,
    RunStateRow,
    SampleBlockRow,
    StepRow,
    UnloadedMarkRow,
)
from cbsr_qa.system.clock import on_tick


def shift_times(event: RunEvent, offset_s: float) -> RunEvent:
    """Return a document with all its times shifted by an offset [s]."""
    if not offset_s:
        return event
    match event:
        case RunStarted() | StepRetried():
            return event
        case FramesTaken(frames=frames):
            reading_time_s = None if frames.reading_time_s is None else frames.reading_time_s + offset_s
            shifted = replace(frames, time_s=frames.time_s + offset_s, reading_time_s=reading_time_s)
            return replace(event, frames=shifted)
        case SamplesTaken(samples=samples):
            return replace(event, samples=replace(samples, time_s=samples.time_s + offset_s))
        case LoadFinished(record=record):
            return replace(event, record=_load(record, offset_s))
        case _:
            return replace(event, time_s=event.time_s + offset_s)


def _load(record: LoadRecord, offset_s: float) -> LoadRecord:
    times = {f.name: getattr(record, f.name) for f in fields(record) if f.name.endswith("_s")}
    eased = tuple(
        replace(step, start_s=step.start_s + offset_s, hold_start_s=step.hold_start_s + offset_s)
        for step in record.eased
    )
    later = {name: time_s + offset_s for name, time_s in times.items() if time_s is not None}
    return replace(record, **later, eased=eased)


#: Steps stored under another name than their class.
_KEPT_AS: Final = {"StrainStep": "Ease"}

#: Columns that hold a time on the run's clock [s], of tables with a phase.
_TIMES = (
    (FrameBlockRow, FrameBlockRow.last_s),
    (StepRow, StepRow.time_s),
    (LoadRow, LoadRow.rest_end_s),
    (UnloadedMarkRow, UnloadedMarkRow.time_s),
    (AttendanceRow, AttendanceRow.time_s),
    (DecisionRow, DecisionRow.time_s),
    (PhaseRow, PhaseRow.started_s),
    (PhaseEndRow, PhaseEndRow.ended_s),
)


def last_time_s(connection: Connection, run: str, phase: int | None = None) -> float:
    """Return the last time stored of a run, or of one phase; 0 where nothing is stored [s]."""
    times_s: list[float | None] = [*_last_samples_s(connection, run, phase)]
    for table, column in _TIMES:
        query = select(func.max(column)).where(table.run == run)
        if phase is not None:
            query = query.where(table.phase == phase)
        times_s.append(connection.scalar(query))
    if phase is None:
        times_s.append(connection.scalar(select(func.max(RunStateRow.time_s)).where(RunStateRow.run == run)))
    return max((float(time_s) for time_s in times_s if time_s is not None), default=0.0)


def _last_samples_s(connection: Connection, run: str, phase: int | None) -> Iterator[float]:
    """Yield the time of the last sample of each channel in each phase; a rest without frames stores nothing else."""
    of_run = select(SampleBlockRow.phase, SampleBlockRow.channel, func.max(SampleBlockRow.block).label("block"))
    of_run = of_run.where(SampleBlockRow.run == run).group_by(SampleBlockRow.phase, SampleBlockRow.channel)
    if phase is not None:
        of_run = of_run.where(SampleBlockRow.phase == phase)
    last = of_run.subquery()
    query = select(*SampleBlockRow.__table__.columns).join(
        last, (SampleBlockRow.phase == last.c.phase) & (SampleBlockRow.block == last.c.block)
    )
    for row in connection.execute(query.where(SampleBlockRow.run == run)):
        yield float(sample_block(row).time_s[-1])


class Journal:
    """Stores the documents of one run: one transaction each, committed when the call returns.

    A run that is stored but not finished is resumed. The clock of a session begins at zero, so times are shifted to
    follow the last stored one.

    Parameters
    ----------
    engine : of an up-to-date database.
    configuration : canonical JSON whose SHA-256 is the identity's digest.
    sensor_type, material, indenter : what is tested, and with which head.
    why : operator's reason for files that differ from those of earlier runs.
    """

    def __init__(
        self,
        engine: Engine,
        *,
        configuration: str,
        sensor_type: SensorType,
        material: Material,
        indenter: Indenter,
        tell: Callable[[str], None] | None = None,
        why: str = "",
        gate: Sequence[GateAnswer] = (),
    ) -> None:
        self._engine = engine
        self._why = why
        self._gate = gate
        self._tell = tell
        self._configuration = configuration
        self._setting = encode_setting(sensor_type, indenter, material)
        self._material = material.name
        self._run = ""
        self._offset_s = 0.0
        self._next: Counter[tuple[str, int]] = Counter()

    def __call__(self, event: RunEvent) -> None:
        """Commit one document.

        Raises
        ------
        StoreError
            If it could not be stored; nothing is stored then.
        """
        if not self._run and not isinstance(event, RunStarted):
            raise StoreError(f"{type(event).__name__} came before the run was started")
        with writing(self._engine, tell=self._tell) as connection:
            self._store(shift_times(event, self._offset_s), connection)

    @singledispatchmethod
    def _store(self, event: object, connection: Connection) -> None:
        raise TypeError(f"{type(event).__name__} is not a document of a run")

    @_store.register
    def _(self, event: RunStarted, connection: Connection) -> None:
        identity = event.identity
        if hashlib.sha256(self._configuration.encode()).hexdigest() != identity.configuration_digest:
            raise StoreError(f"run {identity.run}: the configuration does not match the identity's digest")
        stored = run_row(connection, identity.run)
        if stored is None:
            begin_run(connection, identity, self._configuration, self._setting)
            note_changes(connection, identity, self._configuration, self._material, self._why)
        elif stored.configuration_digest != identity.configuration_digest:
            raise StoreError(
                f"run {identity.run} was begun with another configuration",
                remedy="resume it with its own configuration, or start a new run",
            )
        elif current_state(connection, identity.run).end == EndReason.FINISHED:
            raise StoreError(f"run {identity.run} is finished", remedy="start a new run")
        else:
            self._offset_s = on_tick(last_time_s(connection, identity.run))
        self._run = identity.run
        add_answers(connection, identity.run, self._gate)
        self._state(connection, EndReason.RUNNING, "", self._offset_s, (), identity)

    @_store.register
    def _(self, event: PhaseStarted, connection: Connection) -> None:
        known = select(PhaseRow.phase).where(PhaseRow.run == self._run, PhaseRow.phase == event.index)
        if connection.scalar(known) is None:  # a resumed phase keeps its original start
            values = {"name": event.name, "sequence": event.sequence, "role": str(event.role)}
            row = {"run": self._run, "phase": event.index, **values, "started_s": event.time_s}
            add_rows(connection, self._run, PhaseRow, [row])

    @_store.register
    def _(self, event: StepStarted, connection: Connection) -> None:
        kind = type(event.step).__name__
        step = {"step": _KEPT_AS.get(kind, kind), **asdict(event.step)}
        values = {"number": event.number, "attempt": 0, "step": step, "why": "", "time_s": event.time_s}
        self._add(connection, StepRow.entry, event.phase, values)

    @_store.register
    def _(self, event: StepRetried, connection: Connection) -> None:
        values = {"number": event.number, "attempt": event.attempt, "step": {}, "why": event.why, "time_s": None}
        self._add(connection, StepRow.entry, event.phase, values)

    @_store.register
    def _(self, event: FramesTaken, connection: Connection) -> None:
        if len(event.frames):
            self._add(connection, FrameBlockRow.block, event.phase, frame_values(event.frames))

    @_store.register
    def _(self, event: SamplesTaken, connection: Connection) -> None:
        if len(event.samples):
            self._add(connection, SampleBlockRow.block, event.phase, sample_values(event.samples))

    @_store.register
    def _(self, event: Unloaded, connection: Connection) -> None:
        self._add(connection, UnloadedMarkRow.mark, event.phase, {"time_s": event.time_s})

    @_store.register(RunPaused)
    @_store.register(RunContinued)
    @_store.register(PromptShown)
    @_store.register(PromptAnswered)
    def _(self, event: AttendanceEvent, connection: Connection) -> None:
        self._add(connection, AttendanceRow.entry, event.phase, attendance_values(event))

    @_store.register
    def _(self, event: PressDecided, connection: Connection) -> None:
        errors = {"expected_n": event.expected_N, "upper_n": event.upper_N, "floor_n": event.floor_N}
        row = row_of(DecisionRow, event, run=self._run, load_index=event.load, **errors)
        add_rows(connection, self._run, DecisionRow, [row])

    @_store.register
    def _(self, event: LoadFinished, connection: Connection) -> None:
        times = asdict(event.record)
        load = times.pop("load")
        times["eased"] = [[step.strain, step.start_s, step.hold_start_s] for step in event.record.eased] or None
        values = {"run": self._run, "phase": event.phase, "load_index": times.pop("index"), **load, **times}
        add_rows(connection, self._run, LoadRow, [values])

    @_store.register
    def _(self, event: PhaseFinished, connection: Connection) -> None:
        unended = phases_of(self._run).where(PhaseRow.phase == event.phase, PhaseEndRow.ended_s.is_(None))
        if connection.execute(unended).one_or_none() is None:
            raise StoreError(f"phase {event.phase} of run {self._run} was not started, or has ended already")
        row = {"run": self._run, "phase": event.phase, "ended_s": event.time_s}
        add_rows(connection, self._run, PhaseEndRow, [row])

    @_store.register
    def _(self, event: RunEnded, connection: Connection) -> None:
        if current_state(connection, self._run).end != EndReason.RUNNING:
            raise StoreError(f"run {self._run} has ended already")
        self._state(connection, event.end, event.detail, event.time_s, event.spent)

    def _state(
        self,
        connection: Connection,
        end: EndReason,
        detail: str,
        time_s: float,
        spent: tuple[tuple[str, float], ...],
        identity: RunIdentity | None = None,
    ) -> None:
        number = connection.scalar(select(func.count()).where(RunStateRow.run == self._run))
        values = {"run": self._run, "number": number, "end": str(end), "detail": detail, "time_s": time_s}
        session = {
            "operator": None if identity is None else identity.operator,
            "software": None if identity is None else [list(pair) for pair in identity.software],
            "noted_at": None if identity is None else identity.started_at,
        }
        row = {**values, **session, "spent": [[kind, float(s)] for kind, s in spent]}
        add_rows(connection, self._run, RunStateRow, [row])

    def _add(
        self, connection: Connection, column: InstrumentedAttribute[int], phase: int, values: dict[str, Any]
    ) -> None:
        table: Any = column.class_
        key = (table.__tablename__, phase)
        if key not in self._next:
            place = table.run == self._run, table.phase == phase
            last = connection.scalar(select(func.max(column)).where(*place))
            self._next[key] = 0 if last is None else last + 1
        row = {"run": self._run, "phase": phase, column.key: self._next[key], **values}
        add_rows(connection, self._run, table, [row])
        self._next[key] += 1
