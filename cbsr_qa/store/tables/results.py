"""Tables of results: analyses with measurements, calibrations, and certificates.

Judging a run again adds an analysis; the latest calibration of a sensor is valid. Rows are never changed.
"""

from datetime import datetime
from typing import Any

from sqlalchemy import DDL, ForeignKey, Index, event
from sqlalchemy.orm import Mapped, mapped_column

from cbsr_qa.store.tables.runs import Base, Identifier
from cbsr_qa.store.types import Word


class AnalysisRow(Base):
    """One analysis of a run: the latest holds, the older ones stay."""

    __tablename__ = "analyses"
    __table_args__ = (Index(None, "run", "analysis"),)

    analysis: Mapped[str] = mapped_column(Identifier, primary_key=True)
    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"))
    analysed_at: Mapped[datetime]
    software: Mapped[list[Any]]  #: [[distribution, version], …]
    outcome: Mapped[str] = mapped_column(Word(16))
    reason: Mapped[str]
    calibration_why: Mapped[str]  #: why there is no calibration; empty if there is one
    #: as in the recipe; empty where nothing was imaged
    noise_weighting: Mapped[str] = mapped_column(Word(16))
    weight_ratio: Mapped[float | None]  #: largest over smallest weight of a reading
    compute_s: Mapped[list[Any]]  #: [[stage, seconds], …]


class WarningRow(Base):
    """A warning of an analysis, in plain words."""

    __tablename__ = "warnings"

    analysis: Mapped[str] = mapped_column(Identifier, ForeignKey("analyses.analysis"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    text: Mapped[str]


class MeasurementRow(Base):
    """A named number with its unit, limit and outcome; without a value ``how`` gives the reason."""

    __tablename__ = "measurements"
    __table_args__ = (Index(None, "name"),)

    analysis: Mapped[str] = mapped_column(Identifier, ForeignKey("analyses.analysis"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    name: Mapped[str] = mapped_column(Word(64))
    value: Mapped[float | None]
    unit: Mapped[str]
    uncertainty: Mapped[float | None]
    phase: Mapped[str]
    location: Mapped[str]
    trial: Mapped[int | None]
    qualifier: Mapped[str]
    how: Mapped[str]
    bound: Mapped[str] = mapped_column(Word(16))  #: "exact"; "lower" where the quantity is at least the value
    load_index: Mapped[int | None]  #: within the phase, as in loads: distinguishes equal labels at several strains
    strain: Mapped[float | None]  #: of that load
    outcome: Mapped[str] = mapped_column(Word(16))
    limited: Mapped[bool]  #: whether there was a limit; otherwise the next columns are empty
    lower_limit: Mapped[float | None]
    upper_limit: Mapped[float | None]
    marginal: Mapped[float | None]
    limit_phase: Mapped[str | None]
    limit_qualifier: Mapped[str | None]


class ReanalysisRow(Base):
    """One re-analysis of a run, on trial: it decides nothing until it is adopted as an analysis.

    The key is the digest of what the values follow from: the run's data, the recipe and the software.
    """

    __tablename__ = "reanalyses"
    __table_args__ = (Index(None, "run", "key_sha256"),)

    reanalysis: Mapped[str] = mapped_column(Identifier, primary_key=True)
    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"))
    key_sha256: Mapped[str] = mapped_column(Word(64))
    recipe: Mapped[str]  #: canonical JSON of the file
    analysed_at: Mapped[datetime]
    software: Mapped[list[Any]]  #: [[distribution, version], …]
    outcome: Mapped[str] = mapped_column(Word(16))
    reason: Mapped[str]
    noise_weighting: Mapped[str] = mapped_column(Word(16))
    weight_ratio: Mapped[float | None]
    compute_s: Mapped[list[Any]]  #: [[stage, seconds], …]
    warnings: Mapped[list[Any]]
    measurements: Mapped[list[Any]]  #: rows as in the table of measurements, without empty columns


class AdoptionRow(Base):
    """Somebody made a re-analysis the valid analysis of its run."""

    __tablename__ = "adoptions"

    analysis: Mapped[str] = mapped_column(Identifier, ForeignKey("analyses.analysis"), primary_key=True)
    reanalysis: Mapped[str] = mapped_column(Identifier, ForeignKey("reanalyses.reanalysis"))
    operator: Mapped[str]
    why: Mapped[str]
    adopted_at: Mapped[datetime]


class CalibrationRow(Base):
    """Calibration issued for the sensor of a passed run: its file, and searchable columns."""

    __tablename__ = "calibrations"
    __table_args__ = (Index(None, "serial", "calibration"), Index(None, "run"))

    calibration: Mapped[str] = mapped_column(Identifier, primary_key=True)
    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"))
    analysis: Mapped[str] = mapped_column(Identifier, ForeignKey("analyses.analysis"))
    serial: Mapped[str] = mapped_column(Word(64), ForeignKey("sensors.serial"))
    issued_at: Mapped[datetime]
    content_sha256: Mapped[str] = mapped_column(Word(64))  #: of the issued file's content, as the file states it
    record_sha256: Mapped[str] = mapped_column(Word(64))  #: the same without what is computed again: the matrix
    file: Mapped[bytes]  #: HDF5, as issued
    file_sha256: Mapped[str] = mapped_column(Word(64))  #: of these bytes


# PostgreSQL would try to compress these files, which takes half of the time of storing a run, and fail.
event.listen(
    CalibrationRow.__table__,
    "after_create",
    DDL("ALTER TABLE calibrations ALTER COLUMN file SET STORAGE EXTERNAL").execute_if(  # type: ignore[no-untyped-call]
        dialect="postgresql"
    ),
)


class BaselineRow(Base):
    """Baseline conductance of one place."""

    __tablename__ = "calibration_baselines"

    calibration: Mapped[str] = mapped_column(Identifier, ForeignKey("calibrations.calibration"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    location: Mapped[str]
    x_mm: Mapped[float]
    y_mm: Mapped[float]
    value: Mapped[float | None]
    stderr: Mapped[float | None]
    loads: Mapped[int]
    why: Mapped[str]


class CertificateRow(Base):
    """Calibration certificate of a run, as it was issued; what happened to it later is a row of its own."""

    __tablename__ = "certificates"
    __table_args__ = (Index(None, "run"),)

    certificate: Mapped[str] = mapped_column(Identifier, primary_key=True)
    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"))
    calibration: Mapped[str] = mapped_column(Identifier, ForeignKey("calibrations.calibration"))
    number: Mapped[str] = mapped_column(Word(96), unique=True)
    issued_at: Mapped[datetime]
    signatory: Mapped[str]
    valid_until: Mapped[str | None] = mapped_column(Word(10))  #: ISO date; None: not stated
    replaces: Mapped[str | None] = mapped_column(Word(96))  #: number of another certificate
    why: Mapped[str]  #: reason for replacing it; empty without
    html: Mapped[bytes]
    html_sha256: Mapped[str] = mapped_column(Word(64))
    dcc: Mapped[bytes]  #: digital calibration certificate, XML
    dcc_sha256: Mapped[str] = mapped_column(Word(64))
    signature: Mapped[str | None]  #: text of the signature file; None: not signed


class CertificateWithdrawalRow(Base):
    """A certificate was replaced or revoked; it is under the chain of the run that the certificate is of."""

    __tablename__ = "certificate_withdrawals"
    __table_args__ = (Index(None, "run"), Index(None, "number"))

    withdrawal: Mapped[str] = mapped_column(Identifier, primary_key=True)
    run: Mapped[str] = mapped_column(Identifier, ForeignKey("runs.run"))
    number: Mapped[str] = mapped_column(Word(96))
    replaced_by: Mapped[str | None] = mapped_column(Word(96))  #: None: revoked
    operator: Mapped[str]
    why: Mapped[str]
    noted_at: Mapped[datetime]
