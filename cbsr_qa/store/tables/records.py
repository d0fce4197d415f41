"""Table of links: the chain of digests of each run. Rows are appended, never changed.

Tables of changes to configuration files and verdicts, answers of the checks before a run, released files, references
of control charts, and station checks with the frames of the reference ring. Rows are never changed: the latest of a
chart holds.
"""

from datetime import datetime
from typing import Any, Final

from sqlalchemy import ForeignKey, Index, text
from sqlalchemy.orm import Mapped, mapped_column

from cbsr_qa.store.tables.runs import NO_ROWID, Base, Identifier
from cbsr_qa.store.types import Digest, Word

#: Kinds of nearly all links of a run, which are read with their whole chain; links of others are also found by kind.
MANY_LINKS: Final = ("frame_blocks", "sample_blocks", "steps")
FEW_LINKS: Final = f"kind NOT IN {MANY_LINKS}"
_FEW: Final = text(FEW_LINKS)


class ConfigurationChangeRow(Base):
    """A run used a file of a known name with another content than the latest run before it."""

    __tablename__ = "configuration_changes"
    __table_args__ = (Index(None, "kind", "name"),)

    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"), primary_key=True)
    kind: Mapped[str] = mapped_column(Word(16), primary_key=True)
    name: Mapped[str]
    earlier_run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"))  #: the latest with the old content
    old_sha256: Mapped[str] = mapped_column(Word(64))
    new_sha256: Mapped[str] = mapped_column(Word(64))
    differences: Mapped[list[Any]]  #: [[key, before, after], …] as JSON text; null where the key was absent
    operator: Mapped[str]
    noted_at: Mapped[datetime]
    why: Mapped[str]


class VerdictOverrideRow(Base):
    """An operator's decision that overrides an analysis's verdict; the latest one counts."""

    __tablename__ = "verdict_overrides"
    __table_args__ = (Index(None, "run"),)

    override_id: Mapped[str] = mapped_column(Identifier, primary_key=True)
    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"))
    analysis: Mapped[str] = mapped_column(Identifier, ForeignKey("analyses.analysis"))
    outcome: Mapped[str] = mapped_column(Word(16))
    operator: Mapped[str]
    why: Mapped[str]
    noted_at: Mapped[datetime]


class GateAnswerRow(Base):
    """One answer; a resumed run has those that were asked again under a session of their own."""

    __tablename__ = "gate_answers"

    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"), primary_key=True)
    session: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)  #: 0 when the run began
    subject: Mapped[str] = mapped_column(Word(32), primary_key=True)  #: a GateCheck
    policy: Mapped[str] = mapped_column(Word(16))
    outcome: Mapped[str] = mapped_column(Word(16))  #: a GateOutcome
    words: Mapped[str]
    remedy: Mapped[str]
    operator: Mapped[str]  #: who overrode a refusal; empty otherwise
    why: Mapped[str]


class ReleaseRow(Base):
    """A configuration file was released, or withdrawn; the latest row of a kind and digest holds."""

    __tablename__ = "releases"
    __table_args__ = (Index(None, "sha256", "release_id"),)

    release_id: Mapped[str] = mapped_column(Identifier, primary_key=True)
    kind: Mapped[str] = mapped_column(Word(16))
    name: Mapped[str]
    sha256: Mapped[str] = mapped_column(Word(64))  #: of the content of the file
    outcome: Mapped[str] = mapped_column(Word(16))  #: "released" or "withdrawn"
    operator: Mapped[str]
    why: Mapped[str]
    noted_at: Mapped[datetime]


class ChartReferenceRow(Base):
    """Limits of one chart, from a reference period."""

    __tablename__ = "chart_references"
    __table_args__ = (Index(None, "station", "reference"),)

    reference: Mapped[str] = mapped_column(Identifier, primary_key=True)
    station: Mapped[str]
    recipe: Mapped[str]
    golden: Mapped[str]  #: serial number of a golden sensor; empty for production runs
    name: Mapped[str] = mapped_column(Word(64))
    phase: Mapped[str]
    qualifier: Mapped[str]
    location: Mapped[str]
    unit: Mapped[str]
    kind: Mapped[str] = mapped_column(Word(16))
    settings: Mapped[
        dict[str, Any]
    ]  #: subgroup, rules, weight, width, slack, threshold; retired of a row that ends a chart
    mean: Mapped[float]
    deviation: Mapped[float]
    runs: Mapped[int]
    first_run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"))
    last_run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"))
    operator: Mapped[str]
    made_at: Mapped[datetime]
    why: Mapped[str]


class StationCheckRow(Base):
    """One check of a station."""

    __tablename__ = "station_checks"
    __table_args__ = (Index(None, "station", "check_id"),)

    check_id: Mapped[str] = mapped_column(Identifier, primary_key=True)
    station: Mapped[str]
    operator: Mapped[str]
    checked_at: Mapped[datetime]
    sensor_type: Mapped[str]
    configuration_digest: Mapped[str] = mapped_column(Word(64))
    software: Mapped[list[Any]]  #: [[distribution, version], …]
    instruments: Mapped[list[Any]]  #: those that answered, as in the table of instruments
    outcome: Mapped[str] = mapped_column(Word(16))  #: a CheckOutcome: the worst of its lines
    golden_run: Mapped[str | None] = mapped_column(Identifier, ForeignKey("runs.run"))
    seal: Mapped[str | None]  #: digest of all rows of the check, and its signature, see seals.py; None: removed


class StationCheckLineRow(Base):
    """One line of a check."""

    __tablename__ = "station_check_lines"

    check_id: Mapped[str] = mapped_column(Identifier, ForeignKey("station_checks.check_id"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    subject: Mapped[str]
    name: Mapped[str]
    outcome: Mapped[str] = mapped_column(Word(16))
    value: Mapped[float | None]
    unit: Mapped[str]
    allowed: Mapped[str]
    said: Mapped[str]
    remedy: Mapped[str]


class StationCheckFramesRow(Base):
    """Frames of the reference ring, stored like those of a run."""

    __tablename__ = "station_check_frames"

    check_id: Mapped[str] = mapped_column(Identifier, ForeignKey("station_checks.check_id"), primary_key=True)
    resistances_ohm: Mapped[list[Any]]  #: of the ring
    frames: Mapped[int]
    drives: Mapped[int]
    measures: Mapped[int]
    unit: Mapped[str] = mapped_column(Word(16))
    current_a: Mapped[float | None]
    first_s: Mapped[float]
    last_s: Mapped[float]
    time_s: Mapped[bytes]  #: float64 (frames,)
    voltages: Mapped[bytes]  #: float64 (frames, drives, measures)
    flags: Mapped[bytes]  #: uint8 (frames, drives, measures)
    reading_time_s: Mapped[bytes | None]  #: float64 (frames, drives, measures)
    sha256: Mapped[str] = mapped_column(Digest)


class LinkRow(Base):
    """One link of a run's chain, stored in the transaction of the rows it covers, which form one document."""

    __tablename__ = "run_links"
    __table_args__ = (
        Index(None, "run", "kind", "document", unique=True, sqlite_where=_FEW, postgresql_where=_FEW),
        NO_ROWID,
    )

    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    kind: Mapped[str] = mapped_column(Word(32))  #: the table its rows are in, see run_documents.py
    document: Mapped[str] = mapped_column(Word(64))  #: which of its rows: their common key
    content_sha256: Mapped[str] = mapped_column(Digest)  #: of these rows
    sha256: Mapped[str] = mapped_column(Digest)  #: of the previous link, kind, document and content
    mac: Mapped[str | None] = mapped_column(Digest)  #: HMAC-SHA256 of ``sha256``; None if no key was set


class ArchiveRow(Base):
    """The file that holds the frames of a run; their rows are then without arrays. Removed when they come back."""

    __tablename__ = "archives"

    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"), primary_key=True)
    file: Mapped[str]  #: its path from the folder of a SQLite database, else in full
    file_bytes: Mapped[int]
    file_sha256: Mapped[str] = mapped_column(Digest)
    archived_at: Mapped[datetime]
