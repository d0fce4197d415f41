"""What a passed run issues for its sensor.

What turns a sensor's readings into newtons: fields of its head by place, and how strongly each place answers.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.results.image import LinearReconstruction
from cbsr_qa.domain.results.relaxation import RelaxationFit, RelaxationKernel, SettlingTime
from cbsr_qa.domain.run import Indenter
from cbsr_qa.domain.sensor import QuasiStatic, Response, SensorIdentity, SensorType

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Plain numbers of a force model, by the names of its fields.
NUMBERS: Final = (
    "scatter",
    "threshold",
    "misfit",
    "residue_share",
    "residue_stderr",
    "residue_strength",
    "steady_s",
    "place_scatter_mm",
)


@dataclass(frozen=True, slots=True)
class Lattice:
    """Places on a square lattice, x = x₀ + i h and y = y₀ + j h.

    Parameters
    ----------
    x_mm, y_mm : x₀ and y₀, from the sheet's centre.
    spacing_mm : h.
    columns, rows : how many along x and y.
    """

    x_mm: float
    y_mm: float
    spacing_mm: float
    columns: int
    rows: int

    def places_mm(self) -> Array:
        """All places, (rows · columns, 2), a row after the other [mm]."""
        x = self.x_mm + self.spacing_mm * np.arange(self.columns)
        y = self.y_mm + self.spacing_mm * np.arange(self.rows)
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class ForceModel:
    """How readings become the contrast under a head, and contrast becomes stress.

    A head that changes the conductance under it by κ = Δγ/γ changes the readings in proportion to its *strength*
    a = 2κ/(2 + κ), but for some 0.2 %. At node k of the lattice the readings' change per strength, in standard
    errors of one frame, is row k of ``templates``. Relative response: κ = S (α_σ σ + β_σ) with S = ρ̄₀ over its
    nominal value, 1 for a sheet that answers as its material (paper Eqs 1 and 7).

    Parameters
    ----------
    lattice : of the places.
    node : (rows, columns) int64 index of each place into the arrays below; −1 where no head can be.
    merging : (r, m) [1/V] turns changes of the m used readings into r rows of unit noise.
    templates : (n, r) rows of unit length: the readings' change under the calibrated head is strength × e^log_size ×
        template.
    log_size : (n,) logarithm of a change per strength, in standard errors of one frame.
    size_slope : (n, r) by which a template grows with q − 1, q the head's squared radius over that of the calibrated
        one, at the same strength × area.
    slopes : (n, 5) of ``log_size`` along x and y [1/mm], and products xx, xy, yy of the slopes of a template of unit
        length, how fast it turns with place [1/mm²].
    fits : (n,) whether the head is clear of edge and electrodes there; other nodes are there to interpolate from.
    log_response : (n,) ln S, the map.
    log_response_stderr : (n,) its standard error, without ``scatter``.
    scatter : relative deviation of single loads about the map that noise does not explain.
    stress_kPa : (lowest, highest) of the loads the map was learned from.
    threshold : least detectability d′ (signal over noise of the readings) that counts as a load.
    misfit : largest share of a load's signal, as energy, that the template of a second head may explain before the
        frame counts as one of several. In files of before it was that of all that a template leaves, 0.04 at least.
    residue_share, residue_stderr : share of what earlier loads left just before a press that is still there at its
        steady frames, as the calibration took it.
    residue_strength : root mean square of the strength that earlier loads had left where a load was then pressed.
    steady_s : how long after the ramp's end the map's loads were looked at; forces are of loads held so long [s].
    place_scatter_mm : standard deviation of a found place about the true one, along an axis, beyond noise.
    loading, unloading : how loads get there, and how they fade; None where it was not learned.
    """

    lattice: Lattice
    node: Indices
    merging: Array
    templates: Array
    log_size: Array
    size_slope: Array
    slopes: Array
    fits: NDArray[np.bool_]
    log_response: Array
    log_response_stderr: Array
    scatter: float
    stress_kPa: tuple[float, float]
    threshold: float
    misfit: float
    residue_share: float
    residue_stderr: float
    residue_strength: float = 0.0
    steady_s: float = 0.0
    place_scatter_mm: float = 0.0
    loading: RelaxationKernel | None = None
    unloading: RelaxationKernel | None = None


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
    phase, load, strain : of the load; with phase and index (as in :class:`~cbsr_qa.domain.run.LoadRecord`), loads
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
    digest : SHA-256 of everything above, as :mod:`cbsr_qa.calibration.file` describes it; empty before it is issued.
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
    """What was found out about a sound calibration file; digests as in :mod:`cbsr_qa.calibration.file.digests`.

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
