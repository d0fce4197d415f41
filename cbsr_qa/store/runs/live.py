"""What a run has stored so far, for those who watch it: short reads, nothing locked, no frame read twice."""

from dataclasses import dataclass
from datetime import datetime
from time import monotonic
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, Engine, func, select, tuple_
from sqlalchemy.exc import SQLAlchemyError

from cbsr_qa.domain.filling import fill_from_mapping
from cbsr_qa.domain.plan.limits import FailureCode, Outcome
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock, join_frames
from cbsr_qa.domain.readings.loads import LoadRecord
from cbsr_qa.domain.results.listed import Decision
from cbsr_qa.domain.run.run import PressDecided
from cbsr_qa.domain.run.states import EndReason, ResultState
from cbsr_qa.domain.sensor.sensor_type import SensorPart
from cbsr_qa.store.archives import with_arrays
from cbsr_qa.store.damage import read_word, translate_errors
from cbsr_qa.store.engine import reading, sqlite_file
from cbsr_qa.store.golden import find_golden_runs
from cbsr_qa.store.mapping import convert_row
from cbsr_qa.store.runs.codec import frame_block, sample_block
from cbsr_qa.store.runs.rows import current_state, decisions_of, load_record, phases_of
from cbsr_qa.store.runs.verdicts import verdict_of
from cbsr_qa.store.tables.records import LinkRow
from cbsr_qa.store.tables.results import CalibrationRow
from cbsr_qa.store.tables.runs import FrameBlockRow, LoadRow, RunRow, RunStateRow, SampleBlockRow, UnloadedMarkRow

#: Most blocks of frames, and of samples, that one read returns: the latest ones.
MOST_BLOCKS: Final = 400

#: (phase, block) before the first.
_BEFORE_FIRST: Final = (-1, -1)


@dataclass(frozen=True, slots=True)
class LivePhase:
    """A phase as far as it has come. ``unloaded_from_s`` as in :class:`~cbsr_qa.domain.run.run.PhaseRecord`."""

    index: int
    name: str
    role: Role
    started_s: float
    ended_s: float | None
    unloaded_from_s: float | None


@dataclass(frozen=True, slots=True, eq=False)
class RunTail:
    """What was stored of a run since an earlier look.

    Parameters
    ----------
    phases, loads : all so far, the loads with the index of their phase.
    frames, samples : new blocks with the index of their phase; of many, the latest :data:`MOST_BLOCKS`.
    frames_seen, samples_seen : (phase, block) of the last ones, for the next look.
    decisions : all decisions between presses so far.
    """

    phases: tuple[LivePhase, ...]
    loads: tuple[tuple[int, LoadRecord], ...]
    frames: tuple[tuple[int, FrameBlock], ...]
    samples: tuple[tuple[int, SampleBlock], ...]
    frames_seen: tuple[int, int]
    samples_seen: tuple[int, int]
    decisions: tuple[PressDecided, ...] = ()


@dataclass(frozen=True, slots=True)
class RunLook:
    """A run at a glance.

    Parameters
    ----------
    session_at : when its latest session began.
    worked_at : then, or when the analysis after it was made, whichever is later.
    end, detail : of its latest session; RUNNING if it is in progress or was interrupted.
    outcome, reason, calibrated : of the latest analysis after that session; None and empty without one.
    decision : the latest override of that analysis; None where there is none.
    coded : all failure codes of its recipe; empty where its outcome has none.
    parts : parts of the sensor, as stated with the run.
    simulated : whether anything was simulated.
    altered : what does not match the chain, also its ``reason`` then; it has no outcome. Empty where nothing does.
    """

    run: str
    serial: str
    batch: str
    station: str
    recipe: str
    operator: str
    started_at: datetime
    session_at: datetime
    worked_at: datetime
    end: EndReason
    detail: str
    outcome: Outcome | None
    reason: str
    calibrated: bool
    decision: Decision | None
    coded: tuple[FailureCode, ...] = ()
    parts: tuple[SensorPart, ...] = ()
    altered: str = ""
    simulated: bool = False

    @property
    def verdict(self) -> Outcome | None:
        """What counts: the override if there is one, else the outcome; None without an analysis."""
        return self.outcome if self.decision is None else self.decision.outcome

    @property
    def result(self) -> ResultState:
        return ResultState.from_end(self.end, analysed=self.outcome is not None)


class ChangeNotice:
    """Notices that another connection has written to a database, without reading it.

    SQLite counts changes (``PRAGMA data_version``); other databases are taken to have changed once a second.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._connection: Any = None
        self._seen: Any = None

    def has_changed(self) -> bool:
        """Whether something was written since the last call; True the first time. StoreError if it is unreachable."""
        with translate_errors(self._engine.url):
            now = self._version()
        changed: bool = now != self._seen
        self._seen = now
        return changed

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _version(self) -> int:
        if sqlite_file(self._engine.url) is None:
            return int(monotonic())
        try:
            if self._connection is None:  # the count is kept by each connection
                self._connection = self._engine.raw_connection()
                self._seen = None
            return int(self._connection.cursor().execute("PRAGMA data_version").fetchone()[0])
        except (SQLAlchemyError, self._engine.dialect.dbapi.Error):  # type: ignore[union-attr]
            self._connection = None
            raise


class LiveRuns:
    """Runs for those who watch them."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def read_tail(
        self,
        run: str,
        *,
        frames_after: tuple[int, int] = _BEFORE_FIRST,
        samples_after: tuple[int, int] = _BEFORE_FIRST,
    ) -> RunTail:
        """Read what a run has stored since (phase, block) of its frames and samples.

        Raises
        ------
        StoreError
            If the run does not exist, or a block was altered.
        """
        with reading(self._engine) as connection:
            current_state(connection, run)  # whether it exists
            load_rows = select(*LoadRow.__table__.columns).where(LoadRow.run == run).order_by(LoadRow.press_start_s)
            frames = _latest(connection, FrameBlockRow, run, frames_after)
            samples = _latest(connection, SampleBlockRow, run, samples_after)
            return RunTail(
                phases=_phases(connection, run),
                loads=tuple((row.phase, load_record(row)) for row in connection.execute(load_rows)),
                frames=tuple((row.phase, frame_block(row)) for row in with_arrays(connection, frames)),
                samples=tuple((row.phase, sample_block(row)) for row in samples),
                frames_seen=_last(frames, frames_after),
                samples_seen=_last(samples, samples_after),
                decisions=decisions_of(connection, run),
            )

    def read_frames(self, run: str, phase: int, start_s: float, end_s: float) -> FrameBlock | None:
        """Return the frames of a phase with start_s ≤ time < end_s; None without any."""
        table = FrameBlockRow
        query = select(*table.__table__.columns).where(table.run == run, table.phase == phase)
        query = query.where(table.last_s >= start_s, table.first_s < end_s).order_by(table.block)
        with reading(self._engine) as connection:
            blocks = [frame_block(row) for row in with_arrays(connection, connection.execute(query).all())]
        frames = join_frames(blocks).select_interval(start_s, end_s) if blocks else None
        return frames if frames is not None and len(frames) else None

    def count_links(self, run: str) -> int:
        """Return the number of the last link of a run's chain: it grows with all that is stored of the run."""
        with reading(self._engine) as connection:
            return connection.scalar(select(func.max(LinkRow.number)).where(LinkRow.run == run)) or 0

    def make_notice(self) -> ChangeNotice:
        """Return what notices that another connection has written to the database; close it after use."""
        return ChangeNotice(self._engine)

    def find_latest(self, station: str) -> RunLook | None:
        """Return the latest run of a station; None before its first."""
        return _look(self._engine, RunRow.station == station)

    def find_latest_of_sensor(self, serial: str, recipe: str = "", *, before: str = "") -> RunLook | None:
        """Return the latest run of a sensor at any station; None before its first.

        Parameters
        ----------
        recipe : name of the recipe; empty for any.
        before : run that it precedes; empty for the very latest.
        """
        which = RunRow.serial == serial
        if recipe:
            which &= RunRow.recipe == recipe
        if before:
            which &= RunRow.run < before
        return _look(self._engine, which)

    def find_standing_failure(self, serial: str, recipe: str) -> RunLook | None:
        """Return the latest failed run of a sensor with another recipe that no later pass with that recipe lifts.

        Runs of a golden sensor that checked a station do not count: they judge the station.
        """
        query = select(RunRow.run, RunRow.recipe).where(RunRow.serial == serial, RunRow.recipe != recipe)
        passed_recipes = set()
        with reading(self._engine) as connection:
            others = connection.execute(query.order_by(RunRow.run.desc())).all()
            golden = find_golden_runs(connection, [run for run, _ in others])
        for run, name in others:
            look = None if run in golden or name in passed_recipes else self.find_run(run)
            if look is not None and look.verdict is Outcome.FAIL:
                return look
            if look is not None and look.verdict in (Outcome.PASS, Outcome.MARGINAL):
                passed_recipes.add(name)
        return None

    def find_run(self, run: str) -> RunLook | None:
        """Return a run; None if it is not stored."""
        return _look(self._engine, RunRow.run == run)


def _look(engine: Engine, which: ColumnElement[bool]) -> RunLook | None:
    with reading(engine) as connection:
        run = connection.scalar(select(RunRow.run).where(which).order_by(RunRow.run.desc()).limit(1))
        verdict = None if run is None else verdict_of(connection, run)
        if verdict is None:
            return None
        begun = select(RunStateRow.noted_at).where(RunStateRow.run == run, RunStateRow.noted_at.is_not(None))
        session_at = connection.scalar(begun.order_by(RunStateRow.number.desc()).limit(1))
        issued = select(CalibrationRow.calibration).where(CalibrationRow.run == run).limit(1)
        session_at = session_at or verdict.values["started_at"]
        return fill_from_mapping(
            RunLook,
            verdict.values,
            session_at=session_at,
            worked_at=session_at if verdict.analysed_at is None else max(session_at, verdict.analysed_at),
            end=verdict.end,
            detail=verdict.end_detail,
            outcome=verdict.outcome,
            reason=verdict.altered or verdict.reason,
            calibrated=connection.scalar(issued) is not None,
            decision=verdict.decision,
            coded=verdict.coded,
            parts=verdict.parts,
            altered=verdict.altered,
            simulated=bool(verdict.values["simulated"]),
        )


def _latest(connection: Connection, table: Any, run: str, after: tuple[int, int]) -> list[Any]:
    newest = select(*table.__table__.columns).where(table.run == run, tuple_(table.phase, table.block) > after)
    rows = connection.execute(newest.order_by(table.phase.desc(), table.block.desc()).limit(MOST_BLOCKS)).all()
    return list(reversed(rows))


def _last(rows: list[Any], before: tuple[int, int]) -> tuple[int, int]:
    return (rows[-1].phase, rows[-1].block) if rows else before


def _phases(connection: Connection, run: str) -> tuple[LivePhase, ...]:
    query = select(UnloadedMarkRow.phase, UnloadedMarkRow.time_s).where(UnloadedMarkRow.run == run)
    marks = {row.phase: row.time_s for row in connection.execute(query.order_by(UnloadedMarkRow.mark))}
    return tuple(
        convert_row(
            LivePhase,
            row,
            index=row.phase,
            role=read_word(Role, row.role, "phases.role", f"phase {row.phase} of run {run}"),
            unloaded_from_s=marks.get(row.phase),
        )
        for row in connection.execute(phases_of(run))
    )
