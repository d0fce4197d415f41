"""Stored runs: loaded in full for analysis, or looked up."""

from collections import defaultdict
from dataclasses import dataclass
from datetime import datetime
from itertools import groupby
from typing import Any

from sqlalchemy import Connection, Engine, Result, Row, func, select, type_coerce
from sqlalchemy.orm import InstrumentedAttribute
from sqlalchemy.types import NullType

from cbsr_qa.domain.errors import RefusedError, StoreError
from cbsr_qa.domain.filling import fill_from_mapping
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock, join_frames, join_samples
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.run.attendance import pauses_of, prompts_of
from cbsr_qa.domain.run.run import PhaseRecord, RunIdentity, RunRecord, RunSession
from cbsr_qa.domain.run.states import EndReason, ResultState, was_emergency
from cbsr_qa.store.archives import with_arrays
from cbsr_qa.store.chain.check import IDENTITY, check_run, unreadable
from cbsr_qa.store.chain.links import chain_head, key_to_continue
from cbsr_qa.store.damage import FOREIGN_CELL, address, check_files, name_database, read_word
from cbsr_qa.store.engine import file_problem, look_afresh, reading
from cbsr_qa.store.left_out import find_altered_outside, with_left_out
from cbsr_qa.store.mapping import convert_row
from cbsr_qa.store.runs.attendance import attendance_of, count_prompts
from cbsr_qa.store.runs.codec import (
    decode_indenter,
    decode_material,
    decode_sensor_type,
    frame_block,
    sample_block,
)
from cbsr_qa.store.runs.gate_answers import answers_of
from cbsr_qa.store.runs.journal import last_time_s
from cbsr_qa.store.runs.rows import current_state, decisions_of, identity_of, load_record, phases_of, run_row
from cbsr_qa.store.runs.sessions import Span, sessions_of, spans_that_count, within
from cbsr_qa.store.runs.standing import standing_of
from cbsr_qa.store.runs.verdicts import read_verdicts
from cbsr_qa.store.selected import conditions
from cbsr_qa.store.tables.runs import (
    FrameBlockRow,
    LoadRow,
    PhaseEndRow,
    RunRow,
    RunStateRow,
    SampleBlockRow,
    UnloadedMarkRow,
)
from cbsr_qa.system.clock import on_tick


@dataclass(frozen=True, slots=True)
class RunSummary:
    """A run in one line.

    Parameters
    ----------
    end : RUNNING if it was interrupted or is in progress.
    outcome, reason : of its latest analysis after that session; None and empty without one.
    altered : what does not match the chain; the run has no outcome then. Empty where nothing does.
    """

    run: str
    serial: str
    batch: str
    station: str
    recipe: str
    started_at: datetime
    end: EndReason
    outcome: Outcome | None
    reason: str
    altered: str = ""


class Runs:
    """Stored runs, one by its identifier."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def load(self, run: str) -> RunRecord:
        """Load a run with every frame that counts; its chain and each block's digest are checked.

        Frames and samples of an interrupted press that was repeated do not count; their number is recorded.

        Raises
        ------
        StoreError
            If the run does not exist or was altered.
        """
        with reading(self._engine) as connection:
            head = chain_head(connection, run)  # before the check, which then covers it
            chain, row = check_run(connection, run), _find_run(connection, run)
            state = current_state(connection, run)
            states = select(RunStateRow.spent).where(RunStateRow.run == run).order_by(RunStateRow.number)
            spent_s: defaultdict[str, float] = defaultdict(float)
            for kind, duration_s in (pair for pairs in connection.scalars(states) for pair in pairs):
                spent_s[kind] += duration_s
            try:
                sessions = sessions_of(connection, run)
                phases, set_aside = _phases(connection, run, sessions)
                attended = tuple(attendance_of(connection, run))
                return RunRecord(
                    identity=identity_of(connection, row),
                    sensor_type=decode_sensor_type(row.setting),
                    material=decode_material(row.setting),
                    indenter=decode_indenter(row.setting),
                    phases=phases,
                    end=EndReason(state.end),
                    end_detail=state.detail,
                    station_s=last_time_s(connection, run),
                    spent=tuple(spent_s.items()),
                    sessions=sessions,
                    set_aside=set_aside,
                    pauses=pauses_of(attended),
                    prompts=prompts_of(attended),
                    chain=chain,
                    chain_head=head,
                    decisions=decisions_of(connection, run),
                    gate=answers_of(connection, run),
                )
            except StoreError:
                raise
            except (*FOREIGN_CELL, RefusedError) as error:
                raise unreadable(connection, run, error) from error

    def load_with_file_check(self, run: str) -> RunRecord:
        """Load a run from disk like :meth:`load`, and check the whole file (SQLite).

        Raises
        ------
        StoreError
            If something is damaged; the message says whether the run can be saved.
        """
        look_afresh(self._engine)
        check_files(self._engine.url)  # which is no damage
        problem = file_problem(self._engine)
        try:
            record = self.load(run)
        except StoreError as error:
            if not problem:
                raise
            of_file = error.reason.startswith(
                name_database(self._engine.url)
            )  # repeats the result of the check of the file
            of_run = "" if of_file else f": {error.reason}"
            raise StoreError(
                f"{problem}, including this run{of_run}",
                remedy="restore the database from a copy; data measured after that copy is lost",
            ) from error
        if problem:
            file = address(self._engine.url)
            raise StoreError(
                f"{problem}; every row and frame of this run was checked and is intact",
                remedy="restore the database from a copy, or recover the file:"
                f" sqlite3 {file} .recover | sqlite3 NEW",
            )
        return record

    def read_identity(self, run: str) -> RunIdentity:
        """Return the identity of a run, without frames. StoreError if it does not exist or was altered."""
        with reading(self._engine) as connection:
            check_run(connection, run, IDENTITY)
            return identity_of(connection, _find_run(connection, run))

    def read_configuration(self, run: str) -> str:
        """Return the canonical JSON a run was configured with. StoreError as for :meth:`read_identity`."""
        with reading(self._engine) as connection:
            check_run(connection, run, IDENTITY)
            return str(_find_run(connection, run).configuration)

    def check_resumable(self, run: str) -> None:
        """Check everything that is stored of a run before it is resumed.

        Raises
        ------
        StoreError
            If the run does not exist or was altered, or was signed with another key than the one set.
        """
        with reading(self._engine) as connection:
            check_run(connection, run)
            key_to_continue(connection, run, _find_run(connection, run).chain)

    def list_finished_loads(self, run: str) -> tuple[tuple[int, int], ...]:
        """Return (phase, index) of every finished press in the order of pressing; a resumed run repeats none."""
        with reading(self._engine) as connection:
            _find_run(connection, run)
            query = select(LoadRow.phase, LoadRow.load_index).where(LoadRow.run == run)
            rows = connection.execute(query.order_by(LoadRow.press_start_s, LoadRow.load_index))
            return tuple((phase, load) for phase, load in rows)

    def list_ended_phases(self, run: str) -> frozenset[int]:
        """Return the phases whose last step was carried out, which a resumed run skips."""
        with reading(self._engine) as connection:
            rows = connection.scalars(select(PhaseEndRow.phase).where(PhaseEndRow.run == run))
            return frozenset(rows)

    def read_last_session(self, run: str) -> RunSession:
        """Return the state of a run's latest session."""
        with reading(self._engine) as connection:
            _find_run(connection, run)
            return sessions_of(connection, run)[-1]

    def find_emergency_stop(self, station: str) -> tuple[str, datetime] | None:
        """Return the latest run of a station and when its latest session began, if that was stopped at once.

        A run whose end is damaged tells of no stop: it must not keep its station from other runs.
        """
        ended: list[Any] = [type_coerce(column, NullType()) for column in (RunStateRow.end, RunStateRow.detail)]
        with reading(self._engine) as connection:
            latest = select(RunRow.run).where(RunRow.station == station).order_by(RunRow.run.desc()).limit(1)
            run = connection.scalar(latest)
            states = select(*ended).where(RunStateRow.run == run).order_by(RunStateRow.number.desc()).limit(1)
            end, detail = connection.execute(states).one_or_none() or ("", "")
            if run is None or end != EndReason.ABORTED or not was_emergency(str(detail)):
                return None
            began = select(func.max(RunStateRow.noted_at)).where(RunStateRow.run == run)
            return run, connection.scalar(began) or _find_run(connection, run).started_at

    def read_result_state(self, run: str) -> ResultState:
        """Return what has come of a run. StoreError if it does not exist, or its last state is damaged."""
        with reading(self._engine) as connection:
            return standing_of(connection, run).result

    def count_prompts(self, run: str) -> int:
        """Return the number of prompts a run has shown; a resumed one counts on from there."""
        with reading(self._engine) as connection:
            return count_prompts(connection, run)

    def find_resume_time_s(self, run: str) -> float:
        """Return the start of a resumed session on the run's time line [s]."""
        with reading(self._engine) as connection:
            return on_tick(last_time_s(connection, run))

    def find(self, serial: str | None = None) -> tuple[RunSummary, ...]:
        """Return runs, the latest first: of one sensor, or all. Those that were altered are marked.

        Altered runs of other sensors are among those of one: each may be of it.
        """
        selection = RunSelection(serials=() if serial is None else (serial,))
        with reading(self._engine) as connection:
            query = select(RunRow.run).where(*conditions(selection)).order_by(RunRow.run)
            names = with_left_out(connection, selection, list(connection.scalars(query)))
            verdicts = list(read_verdicts(connection, names))
        return tuple(
            fill_from_mapping(
                RunSummary,
                verdict.values,
                end=verdict.end,
                outcome=verdict.outcome,
                reason=verdict.reason,
                altered=verdict.altered,
            )
            for verdict in reversed(verdicts)
        )

    def resolve(self, run_or_serial: str) -> str:
        """Return a run by its identifier, or the latest run of a serial number.

        Raises
        ------
        StoreError
            If it is neither a stored run nor a tested sensor, or if a later run was altered, which may be of the
            sensor.
        """
        with reading(self._engine) as connection:
            if run_row(connection, run_or_serial) is not None:
                return run_or_serial
            latest = select(RunRow.run).where(RunRow.serial == run_or_serial).order_by(RunRow.run.desc()).limit(1)
            latest_run = connection.scalar(latest)
            later = {} if latest_run is None else find_altered_outside(connection, [RunRow.run > latest_run], ())
        for problem in later.values():
            raise StoreError(
                f"{problem}; it may be a later run of sensor {run_or_serial}",
                remedy="restore the database from a copy, or name the run that is meant: the one before is"
                f" {latest_run}",
            )
        if latest_run is None:
            raise StoreError(
                f"there is no run and no sensor {run_or_serial[:64]!r} in this database",
                remedy="cbsr-qa db status shows the database in use; --database selects another",
            )
        return str(latest_run)


def _find_run(connection: Connection, run: str) -> Row[Any]:
    row = run_row(connection, run)
    if row is None:
        raise StoreError(f"there is no run {run[:64]!r} in this database")
    return row


def _phases(
    connection: Connection, run: str, sessions: tuple[RunSession, ...]
) -> tuple[tuple[PhaseRecord, ...], int]:
    """Return the phases of a run, and how many of their frames do not count."""
    phases = [_phase(connection, row, sessions) for row in connection.execute(phases_of(run)).all()]
    return tuple(phase for phase, _ in phases), sum(aside for _, aside in phases)


def _phase(connection: Connection, row: Row[Any], sessions: tuple[RunSession, ...]) -> tuple[PhaseRecord, int]:
    loads = [load_record(load) for load in _rows(connection, row, LoadRow, LoadRow.load_index)]
    spans = spans_that_count(connection, row, sessions, loads)
    frames, aside = _frames(connection, row, spans)
    marks = select(UnloadedMarkRow.time_s).where(UnloadedMarkRow.run == row.run, UnloadedMarkRow.phase == row.phase)
    phase = convert_row(
        PhaseRecord,
        row,
        index=row.phase,
        # An interrupted phase ends with its last stored time.
        ended_s=last_time_s(connection, row.run, row.phase) if row.ended_s is None else row.ended_s,
        frames=frames,
        samples=_samples(connection, row, spans),
        loads=tuple(load for load in loads if not load.eased),
        loops=tuple(load for load in loads if load.eased),
        # A resumed phase rested again: its presses follow the latest mark.
        unloaded_from_s=connection.scalar(marks.order_by(UnloadedMarkRow.mark.desc()).limit(1)),
        role=read_word(Role, row.role, "phases.role", f"phase {row.phase} of run {row.run}"),
    )
    return phase, aside


def _rows(connection: Connection, phase: Row[Any], table: Any, order: InstrumentedAttribute[int]) -> Result[Any]:
    query = select(*table.__table__.columns).where(table.run == phase.run, table.phase == phase.phase)
    return connection.execute(query.order_by(order))


def _frames(connection: Connection, phase: Row[Any], spans: list[Span]) -> tuple[FrameBlock | None, int]:
    """Return frames that count, and the number that do not."""
    rows = _rows(connection, phase, FrameBlockRow, FrameBlockRow.block).all()
    blocks = [frame_block(row) for row in with_arrays(connection, rows)]
    counted = [within(block.time_s, spans) for block in blocks]
    counted_blocks = [
        block if inside.all() else block.select(inside)
        for block, inside in zip(blocks, counted, strict=True)
        if inside.any()
    ]
    return join_frames(counted_blocks) if counted_blocks else None, sum(int((~inside).sum()) for inside in counted)


def _samples(connection: Connection, phase: Row[Any], spans: list[Span]) -> tuple[SampleBlock, ...]:
    blocks = [sample_block(row) for row in _rows(connection, phase, SampleBlockRow, SampleBlockRow.block)]
    by_channel = groupby(sorted(blocks, key=lambda b: b.channel), key=lambda b: b.channel)  # stable sort
    joined = [join_samples(list(group)) for _, group in by_channel]
    counted_blocks = [(block, within(block.time_s, spans)) for block in joined]
    return tuple(
        SampleBlock(block.channel, block.unit, block.time_s[inside], block.values[inside])
        for block, inside in counted_blocks
        if inside.any()
    )
