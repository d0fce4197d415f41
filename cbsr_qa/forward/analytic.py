"""Exact voltages of a round sheet, homogeneous or with a concentric inclusion: truth for everything that is meshed.

On the edge of such a sheet the current density Σ j_n e^{inθ} makes the potential Σ j_n R g_n/(γ n) e^{inθ} with
g_n = (1 + μ a²ⁿ)/(1 − μ a²ⁿ), μ = (γ − γ_i)/(γ + γ_i) and a the inclusion's radius over the sheet's (Isaacson 1986).
Nothing here uses a mesh, so that agreement with :mod:`cbsr_qa.forward.model` is evidence.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import spherical_jn

from cbsr_qa.domain.errors import NumericsError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ConcentricSheet:
    """A round sheet with a round inclusion in its middle.

    Parameters
    ----------
    radius_mm : of the sheet.
    conductance_S : sheet conductance γ outside the inclusion.
    inclusion_radius_mm : 0 for a homogeneous sheet; below the sheet's.
    inclusion_conductance_S : γ_i; 0 is a hole.
    """

    radius_mm: float
    conductance_S: float
    inclusion_radius_mm: float = 0.0
    inclusion_conductance_S: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.inclusion_radius_mm < self.radius_mm:
            raise NumericsError(f"an inclusion of {self.inclusion_radius_mm} mm does not fit in {self.radius_mm} mm")
        if not (self.conductance_S > 0 and self.inclusion_conductance_S >= 0):
            raise NumericsError("the sheet's conductance must be positive, the inclusion's at least zero")

    def gain(self, order: Array) -> Array:
        """g_n, by how much the inclusion changes the potential of the n-th harmonic: 1 when homogeneous."""
        own, other = self.conductance_S, self.inclusion_conductance_S
        ratio = self.inclusion_radius_mm / self.radius_mm
        seen = (own - other) / (own + other) * ratio ** (2 * order)
        gain: Array = (1 + seen) / (1 - seen)
        return gain


def arc_transfer_impedance(
    sheet: ConcentricSheet,
    angles_rad: Array,
    half_width_rad: float,
    contact_impedance: float,
    *,
    modes: int = 16,
    harmonics: int = 200_000,
) -> Array:
    """Complete electrode model with arcs on the edge, by Legendre–Galerkin on the electrodes (Somersalo et al. 1992).

    The current density of an electrode is expanded in Legendre polynomials, whose Fourier coefficients are spherical
    Bessel functions. ``modes=1`` is the gap model: uniform current density, mean potential.

    Parameters
    ----------
    angles_rad : (electrodes,) centres.
    half_width_rad : half the angle of an arc.
    contact_impedance : z [Ω·mm].
    modes : polynomials an electrode; the error falls fast for z ≥ 0.01 R/γ, slowly for z → 0 (edge singularity).
    harmonics : Fourier terms; what is left out falls with their square.

    Returns
    -------
    (electrodes, electrodes) float64 [Ω], U = Z·I with ΣI = ΣU = 0.
    """
    count, length = len(angles_rad), 2 * half_width_rad * sheet.radius_mm
    order = np.arange(1, harmonics + 1, dtype=np.float64)
    basis = np.stack([spherical_jn(p, order * half_width_rad) for p in range(modes)], axis=1)
    weight = sheet.gain(order) / (np.pi * sheet.conductance_S * order)
    lags, which = _lags(angles_rad)
    table = np.stack([_gram(basis, weight, order, lag) for lag in lags])  # (lags, modes, modes)
    system = table[which].transpose(0, 2, 1, 3)  # (row electrode, row mode, column electrode, column mode)
    own = np.arange(count)
    for p in range(modes):
        system[own, p, own, p] += contact_impedance / (length * (2 * p + 1))
    unknowns = count * (modes - 1)
    higher = system[:, 1:, :, 1:].reshape(unknowns, unknowns)
    coupling = system[:, 1:, :, 0].reshape(unknowns, count)
    impedance = system[:, 0, :, 0] - coupling.T @ np.linalg.solve(higher, coupling)
    return grounded(impedance)


def point_transfer_impedance(sheet: ConcentricSheet, angles_rad: Array, *, harmonics: int = 2000) -> Array:
    """Point electrodes on the edge: the limit of small arcs away from the driven ones.

    Returns
    -------
    (electrodes, electrodes) float64 [Ω]. A point's own potential is infinite and set to 0 here, so that only
    readings that touch no driven electrode mean anything; rows do not sum to zero.
    """
    apart = angles_rad[:, None] - angles_rad
    chord = 2 * np.abs(np.sin(apart / 2))
    np.fill_diagonal(chord, 1)
    order = np.arange(1, harmonics + 1, dtype=np.float64)
    extra = (sheet.gain(order) - 1) / order
    disturbed = np.cos(apart[..., None] * order) @ extra
    impedance = (disturbed - np.log(chord)) / (np.pi * sheet.conductance_S)
    np.fill_diagonal(impedance, 0)
    return np.asarray(impedance, dtype=np.float64)


def grounded(impedance: Array) -> Array:
    """Project a transfer impedance on ΣI = 0 and ΣU = 0."""
    projected = impedance - impedance.mean(axis=0)
    return np.asarray(projected - projected.mean(axis=1, keepdims=True), dtype=np.float64)


def _lags(angles_rad: Array) -> tuple[Array, NDArray[np.int64]]:
    """Different angles between electrodes, and which of them each (row, column) has: equal spacing has few."""
    apart = np.round((angles_rad[:, None] - angles_rad) % (2 * np.pi), 12) % np.round(2 * np.pi, 12)
    lags, which = np.unique(apart, return_inverse=True)
    return lags, which.reshape(apart.shape)


def _gram(basis: Array, weight: Array, order: Array, lag: float) -> Array:
    """Σ_n w_n b_q b_p Re(i^(q−p) e^{in·lag}) over the harmonics, for row mode q and column mode p."""
    even = (basis * (weight * np.cos(order * lag))[:, None]).T @ basis
    odd = (basis * (weight * np.sin(order * lag))[:, None]).T @ basis
    mode = np.arange(basis.shape[1])
    turn = (mode[:, None] - mode) % 4
    return np.select([turn == 0, turn == 1, turn == 2], [even, -odd, -even], odd)
