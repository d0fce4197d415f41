"""Tables of results: analyses with measurements, and calibrations.

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
    noise_weighting: Mapped[str] = mapped_column(Word(16), server_default="equal")
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
    file: Mapped[bytes | None]  #: HDF5, as issued
    file_sha256: Mapped[str | None] = mapped_column(Word(64))  #: of these bytes
    # Up to schema 0011 there was no file: it was reconstructed from the columns that follow, the rows of the tables
    # below, and the run. Later calibrations leave all of them empty except baselines.
    response: Mapped[str | None] = mapped_column(Word(16))
    current_a: Mapped[float | None]
    scale: Mapped[float | None]
    noise_floor: Mapped[float | None]
    mask: Mapped[float | None]
    measured_noise_figure: Mapped[float | None]  #: of this sensor with its own matrix
    method: Mapped[str | None]  #: of the imaging matrix
    regularisation: Mapped[float | None]
    regularisation_name: Mapped[str | None]  #: what ``regularisation`` is, e.g. "λ"
    regularisation_criterion: Mapped[str | None]  #: how it was chosen; empty if not recorded
    regularisation_how: Mapped[str | None]
    noise_figure: Mapped[float | None]  #: of the matrix on the nominal model
    drives: Mapped[int | None]
    measures: Mapped[int | None]
    reference: Mapped[bytes | None]  #: float64 little-endian (drives, measures) [V]
    used: Mapped[bytes | None]  #: uint8 (drives, measures), imaged readings
    reference_sha256: Mapped[str | None] = mapped_column(Word(64))
    no_force: Mapped[str | None]  #: why there is no force model; empty if there is one, or not recorded
    overlap_threshold: Mapped[float | None]
    size_ratio_low: Mapped[float | None]
    size_ratio_high: Mapped[float | None]
    stress_covariance: Mapped[float | None]  #: of α and β against stress [1/kPa]
    strain_covariance: Mapped[float | None]  #: of α and β against strain
    force_low_n: Mapped[float | None]
    force_high_n: Mapped[float | None]
    strain_low: Mapped[float | None]
    strain_high: Mapped[float | None]
    temperature_low_c: Mapped[float | None]
    temperature_high_c: Mapped[float | None]
    radius_mm: Mapped[float | None]
    reduced: Mapped[list[Any] | None]  #: reasons why the range is smaller than intended
    assumed: Mapped[list[Any] | None]  #: names of parameters not measured on this sensor
    simulated: Mapped[list[Any] | None]
    setting: Mapped[dict[str, Any] | None]  #: sensor type and indenter, see runs/codec.py


# PostgreSQL would try to compress these files, which takes half of the time of storing a run, and fail.
event.listen(
    CalibrationRow.__table__,
    "after_create",
    DDL("ALTER TABLE calibrations ALTER COLUMN file SET STORAGE EXTERNAL").execute_if(  # type: ignore[no-untyped-call]
        dialect="postgresql"
    ),
)


class ForceRow(Base):
    """Force model of a sensor, on the lattice of the head's templates.

    The templates follow from sensor type, head, reference and merging.
    """

    __tablename__ = "calibration_forces"

    calibration: Mapped[str] = mapped_column(Identifier, ForeignKey("calibrations.calibration"), primary_key=True)
    merged: Mapped[int]  #: rows after merging the used readings
    readings: Mapped[int]
    merging: Mapped[bytes]  #: float64 little-endian (merged, readings) [1/V]
    nodes: Mapped[int]  #: of the lattice of head positions
    log_response: Mapped[bytes]  #: float64 little-endian (nodes): the map
    log_response_stderr: Mapped[bytes]  #: float64 little-endian (nodes)
    force_sha256: Mapped[str] = mapped_column(Word(64))  #: of these three
    scatter: Mapped[float]
    stress_low_kpa: Mapped[float]
    stress_high_kpa: Mapped[float]
    threshold: Mapped[float]
    misfit: Mapped[float]
    residue_share: Mapped[float]
    residue_stderr: Mapped[float]
    residue_strength: Mapped[float]
    steady_s: Mapped[float]
    place_scatter_mm: Mapped[float]
    kernels: Mapped[dict[str, Any]]  #: "loading" and "unloading" where learned


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


class SettlingRow(Base):
    """Settling times of one signal and direction."""

    __tablename__ = "calibration_settling"

    calibration: Mapped[str] = mapped_column(Identifier, ForeignKey("calibrations.calibration"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    signal: Mapped[str]
    loading: Mapped[bool]
    mean_s: Mapped[float | None]
    deviation_s: Mapped[float | None]
    accepted: Mapped[int]
    censored: Mapped[int]
    rejected: Mapped[int]


class RelaxationRow(Base):
    """A fitted relaxation of one signal after one press or release, and the settling time that follows from it."""

    __tablename__ = "calibration_relaxations"

    calibration: Mapped[str] = mapped_column(Identifier, ForeignKey("calibrations.calibration"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    phase: Mapped[str]
    load_index: Mapped[int | None]  #: within the phase, as in loads
    location: Mapped[str]
    trial: Mapped[int]
    strain: Mapped[float | None]
    signal: Mapped[str]
    unit: Mapped[str]  #: of level, amplitudes and band
    loading: Mapped[bool]
    status: Mapped[str] = mapped_column(Word(32))  #: a FitStatus
    level: Mapped[float]  #: a₀
    level_stderr: Mapped[float]
    amplitude_1: Mapped[float | None]  #: of the shorter time constant
    amplitude_2: Mapped[float | None]
    time_constant_1_s: Mapped[float | None]
    time_constant_2_s: Mapped[float | None]
    time_constant_1_stderr_s: Mapped[float | None]
    time_constant_2_stderr_s: Mapped[float | None]
    r_squared: Mapped[float]
    why: Mapped[str]  #: of a fallback or a rejection
    settling_s: Mapped[float | None]
    settling_censored: Mapped[bool]  #: at least ``settling_s``
    settling_band: Mapped[float]
    settling_why: Mapped[str]


class FitParameterRow(Base):
    """A fit parameter, with its source and whether it was assumed rather than measured on this sensor."""

    __tablename__ = "calibration_parameters"

    calibration: Mapped[str] = mapped_column(Identifier, ForeignKey("calibrations.calibration"), primary_key=True)
    name: Mapped[str] = mapped_column(Word(64), primary_key=True)  #: e.g. "against_stress.slope"
    value: Mapped[float]
    stderr: Mapped[float | None]
    unit: Mapped[str]
    source: Mapped[str]
    assumed: Mapped[bool]


class OverlapBandRow(Base):
    """One band of the area-overlap scale, [lower, upper) percent."""

    __tablename__ = "calibration_overlap_bands"

    calibration: Mapped[str] = mapped_column(Identifier, ForeignKey("calibrations.calibration"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    name: Mapped[str]
    lower_percent: Mapped[float]
    upper_percent: Mapped[float]
