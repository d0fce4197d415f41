"""The device under test: its type, its material and its identity."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Self

import numpy as np

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.geometry.outlines import Disc, Polygon, SheetOutline
from cbsr_qa.domain.kept import OWN, Kept
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.electrodes import Electrodes
from cbsr_qa.domain.sensor.mesh import Mesh, mesh_digest
from cbsr_qa.domain.sensor.patterns import DrivePattern


class Response(StrEnum):
    """Sign of the conductance change under a load."""

    INCREASE = "increase"
    DECREASE = "decrease"
    AUTO = "auto"  #: decided from the calibration loads, and the decision recorded

    @property
    def sign(self) -> int:
        """Factor that makes a load's change positive."""
        return -1 if self is Response.DECREASE else 1


@dataclass(frozen=True, slots=True)
class GivenMesh:
    """A sensor type's own mesh; equal if all its content is.

    Parameters
    ----------
    digest : SHA-256 of its content.
    """

    digest: str
    mesh: Mesh = field(compare=False, repr=False)

    @classmethod
    def from_mesh(cls, mesh: Mesh) -> Self:
        return cls(mesh_digest(mesh), mesh)


@dataclass(frozen=True, slots=True)
class SensorType:
    """Geometry and electrodes of a family of sensors.

    Parameters
    ----------
    name : name as in the shipped or the user's file.
    radius_mm : radius of the round sheet, or of the disc of equal area [mm]: lengths are scaled by it. What asks
        where the sheet ends asks ``outline``.
    electrodes : their layout; they must lie inside the sheet (pins) or on its edge (arcs, strips).
    pattern : drive and measure pairs of these electrodes.
    response : sign of the conductance change under load.
    polygon : the sheet's outline; None where it is a disc.
    mesh : mesh of the forward model, made elsewhere; None where one is made for the outline.

    Raises
    ------
    RefusedError
        If the pattern is of another number of electrodes, or the radius is not that of the polygon's area.
    """

    name: str
    radius_mm: float
    thickness_mm: float
    electrodes: Electrodes
    pattern: DrivePattern
    response: Response
    polygon: Annotated[Polygon | None, Kept("outline/")] = None
    mesh: GivenMesh | None = None

    def __post_init__(self) -> None:
        if self.pattern.electrode_count != self.electrodes.count:
            raise RefusedError(
                f"sensor type {self.name!r} has {self.electrodes.count} electrodes,"
                f" its pattern {self.pattern.electrode_count}"
            )
        if self.mesh is not None and len(self.mesh.mesh.electrode_edges) != self.electrodes.count:
            raise RefusedError(
                f"sensor type {self.name!r} has {self.electrodes.count} electrodes,"
                f" its mesh {len(self.mesh.mesh.electrode_edges)}"
            )
        if self.polygon is not None and abs(self.radius_mm / self.polygon.radius_mm - 1) > 1e-9:
            raise RefusedError(
                f"sensor type {self.name!r}: radius_mm is {self.radius_mm}; the disc of equal area has"
                f" {self.polygon.radius_mm}",
                remedy="use polygon_sensor, which computes it",
            )

    @property
    def outline(self) -> SheetOutline:
        """Outline of the sheet: clearance, extent, centre, edge curve."""
        return Disc(self.radius_mm) if self.polygon is None else self.polygon


def polygon_sensor(
    name: str,
    polygon: Polygon,
    thickness_mm: float,
    electrodes: Electrodes,
    pattern: DrivePattern,
    response: Response = Response.AUTO,
) -> SensorType:
    """Sensor type with a polygon outline."""
    return SensorType(name, polygon.radius_mm, thickness_mm, electrodes, pattern, response, polygon)


@dataclass(frozen=True, slots=True)
class Parameter:
    """A material parameter and its source.

    Parameters
    ----------
    value, stderr : value and standard error in the unit the material file's key names; ``stderr`` is None if not
        stated.
    source : a citation, or "chosen by us" with the reason.
    """

    value: Annotated[float, Kept("", OWN)]
    stderr: Annotated[float | None, Kept("_stderr", OWN)]
    source: Annotated[str, Kept("_source")]


@dataclass(frozen=True, slots=True)
class QuasiStatic:
    """Relative conductance change against stress or strain: Δρ/ρ₀ = slope · x + intercept (paper Eqs 1, 2).

    Parameters
    ----------
    slope : α, per kPa for stress and per unit strain for strain.
    intercept : β, relative.
    covariance : covariance of slope and intercept, in the product of their units; None if not stated.
    """

    slope: Annotated[Parameter, Kept("slope", OWN)]
    intercept: Annotated[Parameter, Kept("intercept", "1")]
    covariance: Annotated[float | None, Kept(units=OWN)] = None  # β has the unit 1

    def variance(self, x: Array) -> Array:
        """Variance (n,) of the change at stresses or strains (n,); an unstated error counts as 0."""
        slope, intercept = self.slope.stderr or 0.0, self.intercept.stderr or 0.0
        return np.maximum((slope * x) ** 2 + intercept**2 + 2 * x * (self.covariance or 0.0), 0.0)


@dataclass(frozen=True, slots=True)
class Relaxation:
    """Two-term relaxation of a unit step, 1 + w₁ e^(−t/τ₁) + w₂ e^(−t/τ₂) (paper Eq 3, over its steady state a₀).

    Parameters
    ----------
    weights : (w₁, w₂), relative to the steady change; negative weights creep up to it.
    time_constants_s : (τ₁, τ₂) [s], rising.
    """

    weights: tuple[float, float]
    time_constants_s: tuple[float, float]
    source: str


@dataclass(frozen=True, slots=True)
class MeasuredKernel:
    """A measured relaxation with its errors, relative to the steady (after a release the released) change.

    After a press 1 + Σ wᵢ e^(−t/τᵢ), after a release Σ wᵢ e^(−t/τᵢ): what creeps up has negative weights under load,
    what fades positive ones after it.

    Parameters
    ----------
    weights, time_constants_s : (k,) w and τ [s].
    covariance : (2 k, 2 k) covariance of (w, log τ).
    start_s : the first reading came this long after the end of the ramp: before, nothing is known.
    window_s : the last one.
    """

    weights: tuple[float, ...]
    time_constants_s: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    start_s: float
    window_s: float


@dataclass(frozen=True, slots=True)
class StripRelaxation:
    """One-dimensional relaxation of a material strip, to compare a sheet with.

    Parameters
    ----------
    loading, unloading : relaxations after a unit step; None if not determined.
    cycles : number of cycles that it was learned from.
    least_strain, largest_strain : least and largest strain of these, as fractions.
    source : origin of the values.
    """

    loading: MeasuredKernel | None
    unloading: MeasuredKernel | None
    cycles: int
    least_strain: float
    largest_strain: float
    source: str


@dataclass(frozen=True, slots=True)
class Material:
    """The sheet's material.

    Parameters
    ----------
    name : e.g. ``"cbsr-8wt"``.
    interelectrode_resistance_ohm : resistance between neighbouring electrodes.
    modulus_kPa : relaxed compressive modulus E.
    loading_relaxation, unloading_relaxation : relaxations of conductance, after a press and after a release.
    relative_noise : rms noise of one reading relative to the mean magnitude of the used readings.
    strip_relaxation : relaxation as measured in one dimension, with its errors; None where it was not.
    response_per_C : relative change of a told force by a degree between calibration and use [1/°C]; None if not
        stated.
    """

    name: str
    interelectrode_resistance_ohm: Parameter
    modulus_kPa: Parameter
    against_stress: QuasiStatic
    against_strain: QuasiStatic
    stress_relaxation: Relaxation
    loading_relaxation: Relaxation
    unloading_relaxation: Relaxation
    relative_noise: Parameter
    strip_relaxation: StripRelaxation | None = None
    response_per_C: Parameter | None = None


@dataclass(frozen=True, slots=True)
class SensorIdentity:
    """One physical sensor."""

    serial: str
    batch: str
    sensor_type: str


@dataclass(frozen=True, slots=True)
class SensorPart:
    """What a sensor was made with: a sheet's lot, a board.

    Parameters
    ----------
    name : e.g. ``"sheet"``.
    identifier : of the lot, or of the part itself.
    revision : may be empty; in a selection empty stands for any.
    """

    name: str
    identifier: str
    revision: str = ""

    def __str__(self) -> str:
        revision = f"/{self.revision}" if self.revision else ""
        return f"{self.name}={self.identifier}{revision}"

    def selects(self, part: "SensorPart") -> bool:
        """Whether a part is the one that a selection means."""
        same = (self.name, self.identifier) == (part.name, part.identifier)
        return same and self.revision in ("", part.revision)
