"""Tables of station checks: what was looked at, and the frames of the reference ring. Rows are never changed."""

from datetime import datetime
from typing import Any

from sqlalchemy import ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from cbsr_qa.store.run_tables import Base, Identifier


class StationCheckRow(Base):
    """One check of a station."""

    __tablename__ = "station_checks"
    __table_args__ = (Index(None, "station", "check_id"),)

    check_id: Mapped[str] = mapped_column(Identifier, primary_key=True)
    station: Mapped[str]
    operator: Mapped[str]
    checked_at: Mapped[datetime]
    sensor_type: Mapped[str]
    configuration_digest: Mapped[str] = mapped_column(String(64))
    software: Mapped[list[Any]]  #: [[distribution, version], …]
    instruments: Mapped[list[Any]]  #: those that answered, as in the table of instruments
    outcome: Mapped[str] = mapped_column(String(16))  #: a CheckOutcome: the worst of its lines
    golden_run: Mapped[str | None] = mapped_column(Identifier, ForeignKey("runs.run"))


class StationCheckLineRow(Base):
    """One line of a check."""

    __tablename__ = "station_check_lines"

    check_id: Mapped[str] = mapped_column(Identifier, ForeignKey("station_checks.check_id"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    subject: Mapped[str]
    name: Mapped[str]
    outcome: Mapped[str] = mapped_column(String(16))
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
    unit: Mapped[str] = mapped_column(String(16))
    current_a: Mapped[float | None]
    first_s: Mapped[float]
    last_s: Mapped[float]
    time_s: Mapped[bytes]  #: float64 (frames,)
    voltages: Mapped[bytes]  #: float64 (frames, drives, measures)
    flags: Mapped[bytes]  #: uint8 (frames, drives, measures)
    reading_time_s: Mapped[bytes | None]  #: float64 (frames, drives, measures)
    sha256: Mapped[str] = mapped_column(String(64))
