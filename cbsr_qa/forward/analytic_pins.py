"""Exact voltages of a homogeneous round sheet with round pins through it: truth for meshes with holes.

Boundary integral over the pins' rims with the Neumann function of the disc (method of images), so that the sheet's
edge needs no unknowns; trapezoidal Nyström points converge exponentially because every rim is a circle (Kress 2014).
"""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.electrodes import ElectrodeLayout
from cbsr_qa.forward.analytic import grounded

Array = NDArray[np.float64]


def pin_transfer_impedance(
    radius_mm: float, conductance_S: float, layout: ElectrodeLayout, contact_impedance: float, *, points: int = 24
) -> Array:
    """Complete electrode model with pins of equal size inside the sheet.

    The potential is a single layer σ on the rims. The current density into the sheet is then
    j = σ/2 − γ ∂u/∂n, the pin's current ∮σ ds, and u + z j = U on its rim.

    Parameters
    ----------
    radius_mm : of the sheet.
    conductance_S : sheet conductance γ.
    layout : of pins.
    contact_impedance : z [Ω·mm].
    points : on each rim, even; 24 reach rounding while a pin is at least its own diameter from the edge.

    Returns
    -------
    (electrodes, electrodes) float64 [Ω], U = Z·I with ΣI = ΣU = 0.
    """
    pin, count = layout.width_mm / 2, layout.count
    turn = 2 * np.pi * np.arange(points) / points
    normal = np.tile(np.column_stack([np.cos(turn), np.sin(turn)]), (count, 1))
    place = np.repeat(layout.positions_mm(), points, axis=0) + pin * normal
    potential, flux = _free_space(place, normal, count, pin)
    image, image_flux = _images(place, normal, radius_mm)
    weight = 2 * np.pi * pin / points
    potential += weight * image
    flux += weight * image_flux
    rim = np.kron(np.eye(count), np.ones((points, 1)))
    system = potential / conductance_S + contact_impedance * (np.eye(len(place)) / 2 + flux)
    density = np.linalg.solve(system, rim)  # σ for one volt on each pin in turn
    admittance = weight * rim.T @ density
    return grounded(np.linalg.inv(admittance))


def _free_space(place: Array, normal: Array, count: int, pin: float) -> tuple[Array, Array]:
    """−1/2π ln|x − y| and minus its normal derivative at x, integrated over the rims."""
    points = len(place) // count
    weight = 2 * np.pi * pin / points
    apart = place[:, None] - place
    squared = (apart**2).sum(axis=2)
    np.fill_diagonal(squared, 1)
    potential = -weight / (4 * np.pi) * np.log(squared)
    flux = weight / (2 * np.pi) * np.einsum("ijk,ik->ij", apart, normal) / squared
    # On its own rim the kernel is singular, but diagonal in Fourier modes: −ρ ln ρ for the mean, ρ/2|m| above it.
    mode = np.abs(np.fft.fftfreq(points, 1 / points))
    eigenvalues = np.where(mode == 0, -pin * np.log(pin), pin / (2 * np.maximum(mode, 1)))
    row = np.fft.ifft(eigenvalues).real
    own = row[(np.arange(points)[:, None] - np.arange(points)) % points]
    for k in range(count):
        block = slice(k * points, (k + 1) * points)
        potential[block, block] = own
        flux[block, block] = weight / (4 * np.pi * pin)
    return potential, flux


def _images(place: Array, normal: Array, radius: float) -> tuple[Array, Array]:
    """Contribution of each point's image beyond the edge, y* = R² y/|y|², and minus its normal derivative at x."""
    far = np.hypot(place[:, 0], place[:, 1])
    image = place * (radius / far)[:, None] ** 2
    apart = place[:, None] - image
    squared = (apart**2).sum(axis=2)
    potential = -np.log(squared * (far / radius) ** 2) / (4 * np.pi)
    flux = np.einsum("ijk,ik->ij", apart, normal) / squared / (2 * np.pi)
    return potential, flux
