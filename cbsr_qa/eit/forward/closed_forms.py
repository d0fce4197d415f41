"""Closed-form voltages of discs and resistor rings: reference solutions for meshed models and stations.

Concentric disc: on its edge the current density Σ j_n e^{inθ} makes the potential Σ j_n R g_n/(γ n) e^{inθ} with g_n
= (1 + μ a²ⁿ)/(1 − μ a²ⁿ), μ = (γ − γ_i)/(γ + γ_i) and a the inclusion's radius over the sheet's (Isaacson 1986). No
mesh is used, so agreement with :mod:`cbsr_qa.eit.forward.model` is independent evidence.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import spherical_jn

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.patterns import DrivePattern


@dataclass(frozen=True, slots=True)
class ConcentricSheet:
    """A round sheet with a round inclusion in its middle.

    Parameters
    ----------
    radius_mm : radius of the sheet.
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
        """g_n, the factor by which the inclusion changes the potential of the n-th harmonic; 1 if homogeneous."""
        outer, inner = self.conductance_S, self.inclusion_conductance_S
        ratio = self.inclusion_radius_mm / self.radius_mm
        reflection = (outer - inner) / (outer + inner) * ratio ** (2 * order)
        return (1 + reflection) / (1 - reflection)


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

    Parameters
    ----------
    angles_rad : (electrodes,) centres.
    half_width_rad : half the angle of an arc.
    contact_impedance : z [Ω·mm].
    modes : Legendre polynomials per electrode; 1 is the gap model. The error falls fast for z ≥ 0.01 R/γ.
    harmonics : Fourier terms; the truncation error decreases with their square.

    Returns
    -------
    (electrodes, electrodes) float64 [Ω], U = Z·I with ΣI = ΣU = 0.
    """
    count, length = len(angles_rad), 2 * half_width_rad * sheet.radius_mm
    order = np.arange(1, harmonics + 1, dtype=np.float64)
    basis = np.stack([spherical_jn(p, order * half_width_rad) for p in range(modes)], axis=1)
    weight = sheet.gain(order) / (np.pi * sheet.conductance_S * order)
    # Different angles between electrodes, and which of them each (row, column) has.
    angles_apart = np.round((angles_rad[:, None] - angles_rad) % (2 * np.pi), 12) % np.round(2 * np.pi, 12)
    lags, lag_index = np.unique(angles_apart, return_inverse=True)
    table = np.stack([_gram(basis, weight, order, lag) for lag in lags])  # (lags, modes, modes)
    # (row electrode, row mode, column electrode, column mode).
    system = table[lag_index.reshape(angles_apart.shape)].transpose(0, 2, 1, 3)
    electrodes = np.arange(count)
    for p in range(modes):
        system[electrodes, p, electrodes, p] += contact_impedance / (length * (2 * p + 1))
    unknowns = count * (modes - 1)
    higher = system[:, 1:, :, 1:].reshape(unknowns, unknowns)
    coupling = system[:, 1:, :, 0].reshape(unknowns, count)
    impedance = system[:, 0, :, 0] - coupling.T @ np.linalg.solve(higher, coupling)
    return project_to_ground(impedance)


def project_to_ground(impedance: Array) -> Array:
    """Project a transfer impedance on ΣI = 0 and ΣU = 0."""
    projected = impedance - impedance.mean(axis=0)
    return np.asarray(projected - projected.mean(axis=1, keepdims=True), dtype=np.float64)


def _gram(basis: Array, weight: Array, order: Array, lag: float) -> Array:
    """Σ_n w_n b_q b_p Re(i^(q−p) e^{in·lag}) over the harmonics, for row mode q and column mode p."""
    even = (basis * (weight * np.cos(order * lag))[:, None]).T @ basis
    odd = (basis * (weight * np.sin(order * lag))[:, None]).T @ basis
    mode = np.arange(basis.shape[1])
    turn = (mode[:, None] - mode) % 4
    return np.select([turn == 0, turn == 1, turn == 2], [even, -odd, -even], odd)


#: Smallest number of resistors that form a ring.
FEWEST_RESISTORS = 3


def ring_impedance(resistances_ohm: Sequence[float] | Array) -> Array:
    """Transfer impedance of a ring of resistors, for currents that sum to zero and differences of potentials.

    The resistance between two electrodes is that of two arcs in parallel, r = s (S − s) / S with S the whole ring; a
    current from a to b makes (r_bc + r_ad − r_ac − r_bd) / 2 between c and d, so that −r / 2 is a transfer impedance
    (Klein & Randić 1993).

    Parameters
    ----------
    resistances_ohm : (n,) the first between electrodes 0 and 1, the last between the last one and 0.

    Returns
    -------
    (n, n) float64 [V/A], symmetric.

    Raises
    ------
    NumericsError
        If there are fewer than three resistors, or one is not above zero and finite.
    """
    ohm = np.asarray(resistances_ohm, dtype=np.float64)
    if ohm.ndim != 1 or len(ohm) < FEWEST_RESISTORS:
        raise NumericsError(f"resistors of shape {ohm.shape} do not form a ring", remedy="give three or more")
    if not (np.isfinite(ohm).all() and (ohm > 0).all()):
        bad = int(np.flatnonzero(~(np.isfinite(ohm) & (ohm > 0)))[0])
        raise NumericsError(f"resistor {bad} of the ring has {ohm[bad]:g} Ω", remedy="it must be positive and finite")
    positions = np.concatenate([[0.0], np.cumsum(ohm[:-1])])
    arc = np.abs(positions[:, None] - positions)
    impedance: Array = -arc * (1 - arc / ohm.sum()) / 2
    return impedance


def ring_readings(resistances_ohm: Sequence[float] | Array, pattern: DrivePattern) -> Array:
    """Readings per ampere of a ring of resistors, (drives, measures) [V/A].

    Of n equal resistors with neighbouring pairs a driven pair reads R (n − 1)/n, and every other pair −R/n.

    Raises
    ------
    NumericsError
        As for :func:`ring_impedance`, or if the pattern has another number of electrodes.
    """
    impedance = ring_impedance(resistances_ohm)
    if len(impedance) != pattern.electrode_count:
        raise NumericsError(
            f"a ring of {len(impedance)} resistors does not match a pattern of {pattern.electrode_count} electrodes",
            remedy="give one for each pair of neighbouring electrodes",
        )
    return pattern.drive_currents().T @ impedance @ pattern.measure_matrix()


def lead_readings(pattern: DrivePattern) -> Array:
    """Contribution of each electrode's lead resistance to a reading: (drives, measures, electrodes) of −1, 0, +1."""
    return pattern.drive_currents().T[:, None, :] * pattern.measure_matrix().T[None, :, :]
