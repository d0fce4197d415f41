"""Reference solutions on a disc that nothing else computes with: point electrodes, pins, meshes fitted to a load.

Disc with round pins: a boundary integral over the pins' rims with the Neumann function of the disc (method of
images), so the sheet's edge needs no unknowns. Trapezoidal Nyström points converge exponentially because every rim
is a circle (Kress 2014).

A fitted mesh has edges along a circle inside it, so every element lies on one side of a round load's outline, and
solutions converge as fast as without a load.
"""

from typing import Final

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.sensor.electrodes import ElectrodeLayout
from cbsr_qa.domain.sensor.mesh import CircleArcs, Mesh
from cbsr_qa.eit.forward.closed_forms import ConcentricSheet, project_to_ground

_CLOSE: Final = 0.6  # nodes nearer to the circle than this share of the local edge length make way for its own
_DENSE: Final = 4000  # points the local edge length is looked up at


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
    return project_to_ground(np.linalg.inv(admittance))


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


def fitted_mesh(mesh: Mesh, centre_mm: tuple[float, float], radius_mm: float) -> tuple[Mesh, Mask]:
    """Put a circle into a mesh.

    Parameters
    ----------
    mesh : convex but for round holes that are electrodes' rims.
    centre_mm, radius_mm : of a circle inside the sheet that touches no hole.

    Returns
    -------
    A mesh of about the same edge lengths with the circle among its arcs, and which elements are inside, (e,) bool.

    Raises
    ------
    RefusedError
        If the circle comes so close to an edge of the sheet that it cannot be followed.
    """
    ring = _ring_fitted_mesh(mesh, np.asarray(centre_mm), radius_mm)
    fixed = np.unique(mesh.outline)
    size = _size_at(mesh, mesh.nodes_mm)
    far = np.abs(np.hypot(*(mesh.nodes_mm - centre_mm).T) - radius_mm) > _CLOSE * size
    kept = far | np.isin(np.arange(len(far)), fixed)
    renumbered = np.cumsum(kept) - 1
    nodes = np.vstack([mesh.nodes_mm[kept], ring])
    following = int(kept.sum()) + np.arange(len(ring))
    circle = np.column_stack([following, np.roll(following, -1)])
    edges = tuple(renumbered[e] for e in mesh.electrode_edges)
    elements = _triangles(nodes, edges)
    arcs = [CircleArcs(renumbered[a.edges], a.centre_mm, a.radius_mm) for a in mesh.arcs]
    fitted = Mesh(nodes, elements, edges, (*arcs, CircleArcs(circle, centre_mm, radius_mm)))
    known = fitted.edges @ np.array([len(nodes), 1])
    if not np.isin(np.sort(circle, axis=1) @ np.array([len(nodes), 1]), known).all():
        raise RefusedError(
            f"a circle of radius {radius_mm:g} mm about {centre_mm} cannot be followed by this mesh",
            remedy="keep it clear of edge and electrodes, or use smaller elements",
        )
    return fitted, np.hypot(*(fitted.centroids_mm - centre_mm).T) < radius_mm


def _size_at(mesh: Mesh, points: Array) -> Array:
    """Edge length of an equilateral triangle as large as the element at each point."""
    nearest = cKDTree(mesh.centroids_mm).query(points)[1]
    size: Array = np.sqrt(mesh.areas_mm2[nearest] * 4 / np.sqrt(3))
    return size


def _ring_fitted_mesh(mesh: Mesh, centre: Array, radius: float) -> Array:
    """Nodes round the circle, as dense as the surrounding mesh."""
    turn = 2 * np.pi * np.arange(_DENSE + 1) / _DENSE
    circle = centre + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    density = 1 / _size_at(mesh, circle)
    total = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2)]) * radius * turn[1]
    count = max(int(np.ceil(total[-1])), 12)
    angle = np.interp(np.arange(count) / count * total[-1], total, turn)
    return centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def _triangles(nodes: Array, rims: tuple[Indices, ...]) -> Indices:
    elements = Delaunay(nodes).simplices.astype(np.int64)
    hole = np.full(len(nodes), -1)
    for number, rim in enumerate(rims):
        hole[rim.ravel()] = number
    own = hole[elements]
    elements = elements[~((own[:, 0] >= 0) & (own == own[:, :1]).all(axis=1))]
    a, b, c = (nodes[elements[:, k]] for k in range(3))
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    elements[twice < 0] = elements[twice < 0][:, ::-1]
    longest = ((b - a) ** 2).sum(axis=1)
    solid: Indices = elements[np.abs(twice) > 1e-9 * longest]
    return solid
