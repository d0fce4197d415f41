"""The calibration issued for a passed sensor: its fields, and how each is kept (:class:`~cbsr_qa.domain.kept.Kept`).

A field added here is written, read, digested, exported, stored and shown.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.imaging import LinearReconstruction, OverlapBand
from cbsr_qa.domain.kept import FROM_ABOVE, NOT_KEPT, Kept
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.plan.standards import ReferenceStandard
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.learned_place import PlaceOfRun
from cbsr_qa.domain.results.relaxation import RelaxationFit, RelaxationKernel, SettlingTime
from cbsr_qa.domain.results.signature import Signature
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic, Response, SensorIdentity, SensorType

#: Largest number of a force model, with a finite square, and largest logarithm in one.
_LARGEST: Final = 1e12
_LARGEST_LOG: Final = 50.0
#: Largest number of nodes along an axis: more than any lattice has, with a representable product.
_MOST_NODES: Final = 10_000
#: Steps of templates and slopes in a file: errors of a template add up to 5e-4 of its length (docs/decisions/0047).
_STEPS: Final = 2**12

_NotNegative = Annotated[float, Kept(least=0, most=_LARGEST)]
_Count = Annotated[int, Kept(least=2, most=_MOST_NODES)]


@dataclass(frozen=True, slots=True)
class Lattice:
    """Places on a square lattice, x = x₀ + i h and y = y₀ + j h.

    Parameters
    ----------
    origin_mm : (x₀, y₀), from the sheet's centre.
    spacing_mm : h.
    columns, rows : numbers of places along x and y.
    """

    origin_mm: Annotated[tuple[float, float], Kept(most=_LARGEST)]
    spacing_mm: Annotated[float, Kept(most=_LARGEST)]
    columns: _Count
    rows: _Count

    def places_mm(self) -> Array:
        """All places, (rows · columns, 2), a row after the other [mm]."""
        x = self.origin_mm[0] + self.spacing_mm * np.arange(self.columns)
        y = self.origin_mm[1] + self.spacing_mm * np.arange(self.rows)
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


@dataclass(frozen=True, slots=True)
class BatchUse:
    """What a map of the response owes to the sensor's batch.

    Parameters
    ----------
    model : digest of the batch's model.
    alike : whether the sensor's loads are like its batch's; if not, the map is that of its loads alone.
    p_value : predictive probability of loads at least as far from what the batch predicts.
    share : mean share of the map's variance that would be gone if the batch's common map were exactly known.
    """

    model: str
    alike: bool
    p_value: Annotated[float, Kept(least=0, most=1)]
    share: Annotated[float, Kept(least=0, most=1)]


@dataclass(frozen=True, slots=True, eq=False)
class ForceModel:
    """How readings become the contrast under a head, and contrast becomes stress.

    A head that changes the conductance under it by κ = Δγ/γ changes the readings in proportion to its *strength* a =
    2κ/(2 + κ), within 0.2 %. At node k of the lattice the readings' change per strength, in standard errors of one
    frame, is row k of ``templates``. Relative response: κ = S (α_σ σ + β_σ) with S = ρ̄₀ over its nominal value, 1
    for a sheet that responds like its material (paper Eqs 1 and 7).

    Parameters
    ----------
    lattice : lattice of the places.
    node : (rows, columns) int64 index of each place into the arrays below; −1 outside the reachable places.
    merging : (r, m) [1/V] turns changes of the m used readings into r rows of unit noise.
    templates : (n, r) rows of unit length: the readings' change under the calibrated head is strength × e^log_size ×
        template.
    log_size : (n,) logarithm of a change per strength, in standard errors of one frame.
    size_slope : (n, r) growth of a template with q − 1, q the head's squared radius over that of the calibrated
        one, at the same strength × area.
    log_size_gradient : (n, 2) slopes of ``log_size`` along x and y [1/mm].
    turning : (n, 3) products xx, xy, yy of the slopes of a template of unit length, how fast it turns with place
        [1/mm²].
    fits : (n,) whether the head is clear of edge and electrodes there; other nodes are there to interpolate from.
    log_response : (n,) ln S, the map.
    log_response_stderr : (n,) its standard error, without ``scatter``.
    scatter : relative deviation of single loads about the map that noise does not explain.
    stress_kPa : (lowest, highest) of the loads the map was learned from.
    threshold : least detectability d′ (signal over noise of the readings) that counts as a load.
    misfit : largest share of a load's signal, as energy, that the template of a second head may explain before the
        frame counts as one of several.
    residue_share, residue_stderr : share of earlier loads' residue before a press that remains at its steady frames.
    residue_strength : root mean square of the strength of that residue at the places of loads.
    steady_s : time after the ramp's end at which the map's loads were evaluated; forces are of loads held so long
        [s].
    place_scatter_mm : standard deviation of a found place about the true one, along an axis, beyond noise.
    loading, unloading : kernels of rise and decay of loads; None if not learned.
    batch : what the map owes to the sensor's batch; None if the recipe has no such prior.
    """

    lattice: Annotated[Lattice, Kept(prepared=True)]
    node: Annotated[Indices, Kept(prepared=True, dims="rows columns")]
    merging: Annotated[Array, Kept(units="1/V", dims="merged readings", most=_LARGEST)]
    templates: Annotated[Array, Kept(prepared=True, single=True, steps=_STEPS, dims="nodes merged", most=_LARGEST)]
    log_size: Annotated[Array, Kept(prepared=True, single=True, dims="nodes", most=_LARGEST_LOG)]
    size_slope: Annotated[Array, Kept(prepared=True, single=True, steps=_STEPS, dims="nodes merged", most=_LARGEST)]
    log_size_gradient: Annotated[Array, Kept(units="1/mm", prepared=True, single=True, dims="nodes 2", most=_LARGEST)]
    turning: Annotated[Array, Kept(units="1/mm^2", prepared=True, single=True, dims="nodes 3", most=_LARGEST)]
    fits: Annotated[NDArray[np.bool_], Kept(prepared=True, dims="nodes")]
    log_response: Annotated[Array, Kept(dims="nodes", most=_LARGEST_LOG)]
    log_response_stderr: Annotated[Array, Kept(dims="nodes", least=0, most=_LARGEST_LOG)]
    scatter: _NotNegative
    stress_kPa: Annotated[tuple[float, float], Kept(most=_LARGEST)]
    threshold: _NotNegative
    misfit: _NotNegative
    residue_share: _NotNegative
    residue_stderr: _NotNegative
    residue_strength: _NotNegative = 0.0
    steady_s: _NotNegative = 0.0
    place_scatter_mm: _NotNegative = 0.0
    loading: Annotated[RelaxationKernel | None, Kept(given=(("loading", True),))] = None
    unloading: Annotated[RelaxationKernel | None, Kept(given=(("loading", False),))] = None
    batch: Annotated[BatchUse | None, Kept(since=7)] = None


@dataclass(frozen=True, slots=True)
class BaselineConductance:
    """Apparent baseline conductance ρ̄₀ of one place (paper Eq 7).

    Parameters
    ----------
    location : label of the load, e.g. ``"L0"``.
    value, stderr : relative image units; ``value`` is None if the load does not determine it.
    loads : number of loads.
    why : reason for a missing value, or a remark.
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
    location, trial : location and trial of the load.
    signal, loading : signal and direction as in :class:`SettlingSummary`.
    phase, load, strain : phase, index and strain of the load; with phase and index (as in ``LoadRecord``), loads of
        one label and trial at several strains stay apart. None if unknown.
    unit : unit of the trace, and so of level, amplitudes and band.
    """

    location: str
    trial: Annotated[int, Kept(units="index")]
    signal: Annotated[str, FROM_ABOVE]
    loading: bool
    fit: Annotated[RelaxationFit, Kept("")]
    settling: Annotated[SettlingTime, Kept("settling_")]
    phase: str = ""
    load: Annotated[int | None, Kept(units="index")] = None
    strain: float | None = None
    unit: Annotated[str, FROM_ABOVE] = "1"


@dataclass(frozen=True, slots=True)
class Validity:
    """Where the calibration may be used.

    Parameters
    ----------
    force_N, strain : (lowest, highest) calibrated, or tested within the stated error.
    temperature_C : (lowest, highest), None if not measured.
    radius_mm : loads further out than this were neither calibrated nor tried.
    reduced : reasons why the range is smaller than the recipe intended.
    """

    force_N: tuple[float, float] | None
    strain: tuple[float, float]
    temperature_C: tuple[float, float] | None
    radius_mm: float
    reduced: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Calibration:
    """One sensor's own calibration, as issued.

    Parameters
    ----------
    calibration, run : time-ordered UUIDs as text.
    issued_at : ISO time with zone.
    reference : (drives, measures) float64 V, the unloaded frame.
    current_A : drive current of the reference.
    reconstruction : matrix with its mesh and used readings.
    response : INCREASE or DECREASE.
    noise_floor, mask : image pre-processing.
    baseline : ρ̄₀ per location.
    against_stress, against_strain : α, β with their sources; "assumed" unless this sensor was characterised.
    assumed : names of parameters taken from the material file, not measured on this sensor.
    overlap_bands, overlap_threshold : thresholds on area overlap [%].
    size_ratio : lowest and highest blob area over head area for which a band counts; None if not recorded.
    simulated : simulated parts of the issuing run; empty for a real one.
    relaxations : every fit the summaries were taken from.
    noise_figure : measured on this sensor with its own matrix, or None. That of the matrix on the nominal model is in
        ``reconstruction.choice``.
    force : model that converts readings to newtons; None if the run's loads do not determine it.
    place : learned from the run's presses, where that is clearly better than the model of the sheet; else None.
    no_force : why there is no force model; empty if there is one.
    standards : reference standards of the station that issued it; those that are missing were not stated.
    response_per_C : of the material: relative change of a told force by a degree between calibration and use.
    digest : SHA-256 of everything above, as :mod:`cbsr_qa.calibration.file` describes it; empty before it is issued.
    record_digest : the same without what is prepared again from the rest: mesh, Jacobian, model frame and matrix.
    file : bytes of its file as it was issued; empty where it was read from something else.
    signature : signature of the digest, as the file states it; None if it is not signed.
    """

    calibration: Annotated[str, Kept("identity/calibration")]
    run: Annotated[str, Kept("identity/run", source="record.identity.run")]
    issued_at: Annotated[str, Kept("identity/issued_at")]
    sensor: Annotated[SensorIdentity, Kept("identity/", source="record.identity.sensor")]
    sensor_type: Annotated[SensorType, Kept(source="record.sensor_type")]
    indenter: Annotated[Indenter, Kept(source="record.indenter")]
    reference: Annotated[Array, Kept("reference/voltages", "V", source="reference")]
    current_A: Annotated[float, Kept("reference/current")]
    scale: Annotated[float, Kept("reference/scale", "A.Ohm", source="scale")]
    reconstruction: LinearReconstruction
    response: Annotated[Response, Kept("image/response", source="response")]
    noise_floor: Annotated[float, Kept("image/noise_floor", source="noise_floor")]
    mask: Annotated[float, Kept("image/mask", source="main_mask")]
    baseline: Annotated[tuple[BaselineConductance, ...], Kept("baseline_conductance/")]
    against_stress: Annotated[QuasiStatic, Kept("quasi_static/against_stress/", "1/kPa")]
    against_strain: Annotated[QuasiStatic, Kept("quasi_static/against_strain/", "1")]
    assumed: tuple[str, ...]
    settling: Annotated[tuple[SettlingSummary, ...], Kept("settling/")]
    overlap_bands: Annotated[tuple[OverlapBand, ...], Kept("area_overlap/", source="settings.overlap_bands")]
    overlap_threshold: Annotated[float, Kept("area_overlap/threshold", "%")]
    validity: Validity
    simulated: Annotated[tuple[str, ...], Kept("identity/simulated", source="record.identity.simulated")] = ()
    relaxations: Annotated[tuple[LoadRelaxation, ...], Kept("relaxation/")] = ()
    size_ratio: Annotated[
        tuple[float, float] | None, Kept("area_overlap/size_ratio", source="settings.size_ratio")
    ] = None
    noise_figure: Annotated[float | None, Kept("image/measured_noise_figure")] = None
    force: ForceModel | None = None
    place: PlaceOfRun | None = None
    no_force: Annotated[str, FROM_ABOVE] = ""  # a text of the group ``force``, which encoding and decoding see to
    standards: Annotated[tuple[ReferenceStandard, ...], Kept("standards/", since=6)] = ()
    response_per_C: Annotated[
        Parameter | None, Kept("validity/response_per_C", "1/degC", since=8, source="record.material.response_per_C")
    ] = None
    digest: Annotated[str, NOT_KEPT] = ""
    record_digest: Annotated[str, NOT_KEPT] = ""
    file: Annotated[bytes, NOT_KEPT] = b""
    signature: Annotated[Signature | None, NOT_KEPT] = None

    def __repr__(self) -> str:
        force = f"no force model: {self.no_force}" if self.force is None else "with force model"
        digest = f", SHA-256 {self.digest[:12]}…" if self.digest else ""
        return f"<Calibration of sensor {self.sensor.serial}, issued at {self.issued_at}, {force}{digest}>"


@dataclass(frozen=True, slots=True)
class VerifiedFile:
    """What was found out about a sound calibration file; digests as in :mod:`cbsr_qa.calibration.file.content`.

    Parameters
    ----------
    bytes_checked : whether the file states a digest of its bytes, which was checked before they were parsed.
    signature : signature as the file states it; None if it is not signed.
    """

    path: Path
    schema_version: int
    digest: str
    record_digest: str
    datasets: int
    bytes_checked: bool
    signature: Signature | None = None
