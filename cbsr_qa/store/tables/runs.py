"""Tables of runs: sensors, runs, phases, frames, samples, presses.

Rows are appended and never changed.
"""

from datetime import datetime
from typing import Any

from sqlalchemy import JSON, ForeignKey, ForeignKeyConstraint, Index, LargeBinary, MetaData
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

from cbsr_qa.store.types import Digest, FiniteDouble, Instant, PlainText, Whole, Word

#: Constraints have the same names on every database, so that a migration can name them.
NAMING = {
    "ix": "ix_%(table_name)s_%(column_0_N_name)s",
    "uq": "uq_%(table_name)s_%(column_0_N_name)s",
    "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
    "pk": "pk_%(table_name)s",
}

#: SQLite then stores the rows in the index of their key, which takes no room of its own; for rows below a kilobyte.
NO_ROWID = {"sqlite_with_rowid": False}

Identifier = Word(36)  #: a time-ordered UUID as text


class Base(DeclarativeBase):
    """Base of every table."""

    metadata = MetaData(naming_convention=NAMING)
    type_annotation_map = {  # noqa: RUF012 - SQLAlchemy reads it as a class attribute
        float: FiniteDouble,
        int: Whole,
        str: PlainText,
        datetime: Instant,
        bytes: LargeBinary,
        list[Any]: JSON,
        dict[str, Any]: JSON,
    }


class SensorRow(Base):
    """One physical sensor; batch and type as first seen."""

    __tablename__ = "sensors"

    serial: Mapped[str] = mapped_column(Word(64), primary_key=True)
    batch: Mapped[str]
    sensor_type: Mapped[str]


class RunRow(Base):
    """One recipe on one sensor at one station, with everything that traces it."""

    __tablename__ = "runs"
    __table_args__ = (
        Index(None, "serial", "run"),
        Index(None, "station", "run"),
        Index(None, "batch"),
        Index(None, "started_at"),
        Index(None, "station", "started_at"),
        Index(None, "before_run"),
    )

    run: Mapped[str] = mapped_column(Identifier, primary_key=True)
    serial: Mapped[str] = mapped_column(Word(64), ForeignKey("sensors.serial"))
    batch: Mapped[str]
    sensor_type: Mapped[str]
    station: Mapped[str]
    recipe: Mapped[str]
    operator: Mapped[str]
    started_at: Mapped[datetime]
    configuration: Mapped[str]  #: canonical JSON
    configuration_digest: Mapped[str] = mapped_column(Word(64))
    software: Mapped[list[Any]]  #: [[distribution, version], …]
    simulated: Mapped[list[Any]]  #: in words
    setting: Mapped[dict[str, Any]]  #: sensor type, material and indenter in domain terms, see runs/codec.py
    chain: Mapped[str | None] = mapped_column(Word(64))  #: chain and key (chain/links.py); None: removed
    before_run: Mapped[str | None] = mapped_column(
        Identifier
    )  #: begun before it in the same database; None: none was
    before_link: Mapped[int | None]  #: number of the last link of that run at the time; None: it has none
    before_sha256: Mapped[str | None] = mapped_column(Digest)  #: of that link


class RunBegunRow(Base):
    """A run that was begun in this database, in order; a run that was sent here from another database has no row.

    It refers to nothing, so that it outlives the rows of its run.
    """

    __tablename__ = "runs_begun"
    __table_args__ = (NO_ROWID,)

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)  #: from 0
    run: Mapped[str] = mapped_column(Identifier, unique=True)
    sha256: Mapped[str] = mapped_column(Digest)  #: of its first link


class RunStateRow(Base):
    """State of a run: one row when it begins, is resumed, and ends. The highest number holds."""

    __tablename__ = "run_states"

    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    end: Mapped[str]  #: an EndReason; "running" from begin or resume on
    detail: Mapped[str]
    time_s: Mapped[float]  #: on the run's clock
    spent: Mapped[list[Any]]  #: [[kind of step, seconds], …] of the session that ended
    operator: Mapped[str | None]  #: who began or resumed the session; None if not recorded, and at its end
    software: Mapped[list[Any] | None]  #: [[distribution, version], …] when begun or resumed
    noted_at: Mapped[datetime | None]  #: by the wall clock, which may be wrong; ``number`` gives the order


class InstrumentRow(Base):
    """An instrument on the bench."""

    __tablename__ = "instruments"

    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"), primary_key=True)
    position: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    role: Mapped[str]
    driver: Mapped[str]
    model: Mapped[str]
    serial: Mapped[str]
    firmware: Mapped[str]
    simulated: Mapped[bool]
    calibration_due: Mapped[str | None]
    notes: Mapped[list[Any] | None]  #: [[what, value], …] in words; None if not recorded


class PartRow(Base):
    """A part of the sensor of a run."""

    __tablename__ = "run_parts"
    __table_args__ = (Index(None, "name", "identifier"), NO_ROWID)

    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"), primary_key=True)
    name: Mapped[str] = mapped_column(Word(64), primary_key=True)
    identifier: Mapped[str] = mapped_column(Word(64))
    revision: Mapped[str]


class PhaseRow(Base):
    """One sequence of a run; without a row in ``phase_ends`` it was interrupted."""

    __tablename__ = "phases"

    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"), primary_key=True)
    phase: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    name: Mapped[str]
    sequence: Mapped[str]
    role: Mapped[str] = mapped_column(Word(16))  #: a Role: the purpose of the sequence
    started_s: Mapped[float]


def _phase_key() -> ForeignKeyConstraint:
    return ForeignKeyConstraint(["run", "phase"], ["phases.run", "phases.phase"])


class PhaseEndRow(Base):
    """The end of a phase."""

    __tablename__ = "phase_ends"
    __table_args__ = (_phase_key(), NO_ROWID)

    run: Mapped[str] = mapped_column(Identifier, primary_key=True)
    phase: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    ended_s: Mapped[float]


class StepRow(Base):
    """A step that began, or was tried again; the last one of an interrupted run shows where it stopped."""

    __tablename__ = "steps"
    __table_args__ = (_phase_key(),)

    run: Mapped[str] = mapped_column(Identifier, primary_key=True)
    phase: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    entry: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)  #: counts rows of the phase
    number: Mapped[int]  #: of the step within its phase
    attempt: Mapped[int]  #: 0 for the first
    step: Mapped[dict[str, Any]]  #: {"step": kind, …its fields}; empty for a further attempt
    why: Mapped[str]  #: why it is tried again; empty on the first attempt
    time_s: Mapped[float | None]  #: None for a further attempt


class FrameBlockRow(Base):
    """Consecutive frames: little-endian arrays, one transaction per block, checked by their digest when read."""

    __tablename__ = "frame_blocks"
    __table_args__ = (_phase_key(),)

    run: Mapped[str] = mapped_column(Identifier, primary_key=True)
    phase: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    block: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    frames: Mapped[int]
    drives: Mapped[int]
    measures: Mapped[int]
    unit: Mapped[str] = mapped_column(Word(16))
    current_a: Mapped[float | None]
    first_s: Mapped[float]
    last_s: Mapped[float]
    time_s: Mapped[bytes]  #: float64 (frames,), compact like the following, see runs/codec.py
    voltages: Mapped[bytes]  #: float64 (frames, drives, measures)
    flags: Mapped[bytes]  #: uint8 (frames, drives, measures)
    reading_time_s: Mapped[bytes | None]  #: float64 (frames, drives, measures)
    sha256: Mapped[str] = mapped_column(Digest)  #: of the arrays as they were measured


class SampleBlockRow(Base):
    """Consecutive samples of one channel, stored like frames."""

    __tablename__ = "sample_blocks"
    __table_args__ = (_phase_key(), NO_ROWID)

    run: Mapped[str] = mapped_column(Identifier, primary_key=True)
    phase: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    block: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    channel: Mapped[str]
    unit: Mapped[str] = mapped_column(Word(16))
    samples: Mapped[int]
    time_s: Mapped[bytes]  #: float64 (samples,)
    sample_values: Mapped[bytes]  #: float64 (samples,)
    sha256: Mapped[str] = mapped_column(Digest)


class LoadRow(Base):
    """A press that was held to its end."""

    __tablename__ = "loads"
    __table_args__ = (_phase_key(),)

    run: Mapped[str] = mapped_column(Identifier, primary_key=True)
    phase: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    load_index: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    label: Mapped[str]
    x_mm: Mapped[float]
    y_mm: Mapped[float]
    strain: Mapped[float]
    trial: Mapped[int]
    press_start_s: Mapped[float]
    hold_start_s: Mapped[float]
    release_start_s: Mapped[float]
    release_end_s: Mapped[float]
    rest_end_s: Mapped[float]
    clear_s: Mapped[float | None]  #: when the head left the sheet on its way up; None if not recorded
    eased: Mapped[list[Any] | None]  #: [strain, start_s, hold_start_s] of each further strain; None: none


class AttendanceRow(Base):
    """A pause began or ended, a prompt was shown or answered."""

    __tablename__ = "attendance"
    __table_args__ = (_phase_key(),)

    run: Mapped[str] = mapped_column(Identifier, primary_key=True)
    phase: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    entry: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)  #: counts rows of the phase
    kind: Mapped[str] = mapped_column(Word(16))  #: "paused", "continued", "shown" or "answered"
    prompt: Mapped[int | None]  #: identity within the run; None for pauses
    text: Mapped[str]  #: of the prompt, or its answer; empty for pauses
    picture: Mapped[str]  #: name of the image shown with a prompt; empty without one
    by: Mapped[str]  #: who asked for it or answered; empty of a prompt that is shown
    time_s: Mapped[float]


class DecisionRow(Base):
    """What was decided after some presses of a phase: which is next, or that the phase ends."""

    __tablename__ = "decisions"
    __table_args__ = (_phase_key(), NO_ROWID)

    run: Mapped[str] = mapped_column(Identifier, primary_key=True)
    phase: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    pressed: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)  #: presses of the phase so far
    load_index: Mapped[int | None]  #: of the next press; None: the phase ends
    label: Mapped[str]  #: of the next press
    x_mm: Mapped[float | None]
    y_mm: Mapped[float | None]
    expected_n: Mapped[float | None]  #: expected force error of what was learned so far [N]; None: nothing was
    upper_n: Mapped[float | None]  #: its upper bound [N]
    floor_n: Mapped[float | None]  #: what would remain if the map were known [N]
    why: Mapped[str] = mapped_column(Word(16))  #: "start", "error", "target" or "most presses"
    time_s: Mapped[float]


class UnloadedMarkRow(Base):
    """Time from which the sheet counted as rested; a resumed phase has one per session, the latest holds."""

    __tablename__ = "unloaded_marks"
    __table_args__ = (_phase_key(),)

    run: Mapped[str] = mapped_column(Identifier, primary_key=True)
    phase: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    mark: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    time_s: Mapped[float]
