"""What a passed run issues for its sensor."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.force_model import ForceModel
from cbsr_qa.domain.loads import Indenter
from cbsr_qa.domain.reconstruction import LinearReconstruction
from cbsr_qa.domain.relaxation import RelaxationFit, SettlingTime
from cbsr_qa.domain.sensor import QuasiStatic, Response, SensorIdentity, SensorType


@dataclass(frozen=True, slots=True)
class BaselineConductance:
    """Apparent baseline conductance ρ̄₀ of one place (paper Eq 7).

    Parameters
    ----------
    location : label of the load, e.g. ``"L0"``.
    x_mm, y_mm : its place.
    value, stderr : relative image units; ``value`` is None where the load says nothing about it.
    loads : how many loads it was taken from.
    why : reason where there is no value, or a remark.
    """

    location: str
    x_mm: float
    y_mm: float
    value: float | None
    stderr: float | None
    loads: int
    why: str = ""


@dataclass(frozen=True, slots=True)
class SettlingSummary:
    """Settling times of one signal and direction over all loads of a run.

    Parameters
    ----------
    signal : ``"conductance"`` or ``"stress"``.
    loading : True after the press, False after the release.
    mean_s, deviation_s : over the accepted ones, censored ones counted as at least their window; None if none.
    accepted, censored, rejected : counts.
    """

    signal: str
    loading: bool
    mean_s: float | None
    deviation_s: float | None
    accepted: int
    censored: int
    rejected: int


@dataclass(frozen=True, slots=True)
class LoadRelaxation:
    """Relaxation of one signal after one press or release, as it was fitted.

    Parameters
    ----------
    location, trial : of the load.
    signal, loading : as in :class:`SettlingSummary`.
    phase, load, strain : of the load; with phase and index (as in :class:`~cbsr_qa.domain.loads.LoadRecord`), loads
        of one label and trial at several strains stay apart. None where they are not known.
    unit : of the trace, and so of level, amplitudes and band.
    """

    location: str
    trial: int
    signal: str
    loading: bool
    fit: RelaxationFit
    settling: SettlingTime
    phase: str = ""
    load: int | None = None
    strain: float | None = None
    unit: str = "1"


@dataclass(frozen=True, slots=True)
class Validity:
    """Where the calibration may be used.

    Parameters
    ----------
    force_N, strain : (lowest, highest) calibrated, or tried and found to be told within the stated error.
    temperature_C : (lowest, highest), None where it was not measured.
    radius_mm : loads further out than this were neither calibrated nor tried.
    reduced : reasons why the range is smaller than the recipe intended.
    """

    force_N: tuple[float, float] | None
    strain: tuple[float, float]
    temperature_C: tuple[float, float] | None
    radius_mm: float
    reduced: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class OverlapBand:
    """One band of the area-overlap scale, [lower, upper) percent."""

    name: str
    lower: float
    upper: float


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """One sensor's own calibration, as issued.

    Parameters
    ----------
    calibration, run : time-ordered UUIDs as text.
    issued_at : ISO time with zone.
    sensor, sensor_type, indenter : what it is for.
    reference : (drives, measures) float64 V, the unloaded frame.
    current_A : drive current of the reference.
    scale : see :class:`LinearReconstruction`.
    reconstruction : matrix with its mesh and used readings.
    response : INCREASE or DECREASE.
    noise_floor, mask : image pre-processing.
    baseline : ρ̄₀ per location.
    against_stress, against_strain : α, β with their sources; "assumed" unless this sensor was characterised.
    assumed : names of what was taken from the material file and not measured on this sensor.
    settling : summaries.
    overlap_bands, overlap_threshold : thresholds on area overlap [%].
    size_ratio : lowest and highest blob area over head area for which a band counts; None where nobody said.
    validity : range of use.
    simulated : what was simulated in the issuing run; empty for a real one.
    relaxations : every fit the summaries were taken from.
    noise_figure : measured on this sensor with its own matrix; None where it was not. That of the matrix on the
        nominal model is in ``reconstruction.choice``.
    force : what turns readings into newtons; None where the run's loads gave none.
    no_force : why there is none; empty where there is one.
    digest : SHA-256 of everything above, as :mod:`cbsr_qa.calibrate.digests` describes it; empty before it is issued.
    record_digest : the same without what is prepared again from the rest: mesh, Jacobian, model frame and matrix.
    """

    calibration: str
    run: str
    issued_at: str
    sensor: SensorIdentity
    sensor_type: SensorType
    indenter: Indenter
    reference: NDArray[np.float64]
    current_A: float
    scale: float
    reconstruction: LinearReconstruction
    response: Response
    noise_floor: float
    mask: float
    baseline: tuple[BaselineConductance, ...]
    against_stress: QuasiStatic
    against_strain: QuasiStatic
    assumed: tuple[str, ...]
    settling: tuple[SettlingSummary, ...]
    overlap_bands: tuple[OverlapBand, ...]
    overlap_threshold: float
    validity: Validity
    simulated: tuple[str, ...] = ()
    relaxations: tuple[LoadRelaxation, ...] = ()
    size_ratio: tuple[float, float] | None = None
    noise_figure: float | None = None
    force: ForceModel | None = None
    no_force: str = ""
    digest: str = ""
    record_digest: str = ""


@dataclass(frozen=True, slots=True)
class VerifiedFile:
    """What was found out about a sound calibration file; digests as in :mod:`cbsr_qa.calibrate.digests`.

    Parameters
    ----------
    bytes_checked : whether the file states a digest of its bytes, which was checked before they were parsed.
    """

    path: Path
    schema_version: int
    digest: str
    record_digest: str
    datasets: int
    bytes_checked: bool
