"""The device under test: its type, its material and its identity."""

from dataclasses import dataclass
from enum import StrEnum

from cbsr_qa.domain.electrodes import ElectrodeLayout
from cbsr_qa.domain.patterns import DrivePattern


class Response(StrEnum):
    """What a load does to the conductance of the place it presses."""

    INCREASE = "increase"
    DECREASE = "decrease"
    AUTO = "auto"  #: decided from the calibration loads, and the decision recorded


@dataclass(frozen=True, slots=True)
class SensorType:
    """Geometry and electrodes of a family of sensors.

    Parameters
    ----------
    name : as in the shipped or the user's file.
    radius_mm, thickness_mm : of the round sheet.
    electrodes : their layout; the ring must lie inside the sheet (pins) or on its edge (arcs).
    pattern : drive and measure pairs.
    response : sign of the conductance change under load.
    """

    name: str
    radius_mm: float
    thickness_mm: float
    electrodes: ElectrodeLayout
    pattern: DrivePattern
    response: Response


@dataclass(frozen=True, slots=True)
class Parameter:
    """A material parameter and where it comes from.

    Parameters
    ----------
    value, stderr : in the unit the material file's key names; ``stderr`` is None where nobody stated one.
    source : a citation, or "chosen by us" with the reason.
    """

    value: float
    stderr: float | None
    source: str


@dataclass(frozen=True, slots=True)
class QuasiStatic:
    """Relative conductance change against stress or strain: Δρ/ρ₀ = slope · x + intercept (paper Eqs 1, 2).

    Parameters
    ----------
    slope : α, per kPa for stress and per unit strain for strain.
    intercept : β, relative.
    covariance : of slope and intercept, in the product of their units; None where nobody stated one.
    """

    slope: Parameter
    intercept: Parameter
    covariance: float | None = None


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
class Material:
    """What the sheet is made of.

    Parameters
    ----------
    name : e.g. ``"cbsr-8wt"``.
    interelectrode_resistance_ohm : resistance between neighbouring electrodes.
    modulus_kPa : relaxed compressive modulus E.
    against_stress, against_strain : quasi-static fits.
    stress_relaxation : of stress.
    loading_relaxation, unloading_relaxation : of conductance, after a press and after a release.
    relative_noise : rms noise of one reading relative to the mean magnitude of the used readings.
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


@dataclass(frozen=True, slots=True)
class SensorIdentity:
    """One physical sensor."""

    serial: str
    batch: str
    sensor_type: str
