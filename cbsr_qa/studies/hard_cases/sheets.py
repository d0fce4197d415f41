"""Sheets of the hard cases: the usual sensor as a linear problem, and a small one that can be solved in fifty digits.

Readings of the small sheet are solved by the complete electrode model's textbook form (Vauhkonen et al. 1999): first
order, the electrodes' potentials among the unknowns, stiffness from the corners' places. It shares no code with
:mod:`cbsr_qa.eit.forward`, which eliminates those potentials in doubles.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, Final

import numpy as np
from mpmath import mp
from numpy.typing import NDArray

from cbsr_qa.domain.imaging import ImagingProblem, PreparedReconstruction
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.patterns import DrivePattern, adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import Response, SensorType
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.studies.hard_cases.exact import DIGITS, relative_difference

IMAGE_MM: Final = 6.0


def make_usual_sensor() -> SensorType:
    """The 100 mm disc with sixteen pins, adjacent drives and measurements."""
    layout = ElectrodeLayout(16, ElectrodeKind.PIN, 48.0, 0.65, 0.0, counterclockwise=True)
    return SensorType("stability", 50.0, 4.0, layout, adjacent_pattern(16), Response.AUTO)


@lru_cache(maxsize=1)
def _plugins() -> Plugins:
    return discover()


def prepare_method(name: str, problem: ImagingProblem, options: Mapping[str, Any]) -> PreparedReconstruction:
    """Prepare an installed method, as ``analyse`` does."""
    method: PreparedReconstruction = _plugins().factory(Kind.RECONSTRUCTION, name)(**options).prepare(problem)
    return method


@lru_cache(maxsize=4)
def make_usual_problem(kind: str = "whole") -> ImagingProblem:
    """The usual sensor on a coarse image; with three electrodes masked, or noise over twelve decades."""
    sensor = make_usual_sensor()
    full_problem = imaging_problem(sensor, image_size_mm=IMAGE_MM)
    if kind == "masked":
        return imaging_problem(sensor, used=mask_electrodes(sensor, (2, 7, 12)), image_size_mm=IMAGE_MM)
    if kind == "noisy":
        decades = np.random.default_rng(20261122).permutation(np.linspace(-6, 6, len(full_problem.reference)))
        return imaging_problem(sensor, noise_variance=0.9 * 10**decades, image_size_mm=IMAGE_MM)
    return full_problem


def mask_electrodes(sensor: SensorType, electrodes: tuple[int, ...]) -> NDArray[np.bool_]:
    """Readings (drives, measures) that touch none of some electrodes."""
    pattern, chosen = sensor.pattern, list(electrodes)
    drives = (pattern.drive_currents()[chosen] != 0).any(axis=0)
    measures = (pattern.measure_matrix()[chosen] != 0).any(axis=0)
    return np.asarray(pattern.usable() & ~drives[:, None] & ~measures, dtype=np.bool_)


#: Arrays of mpmath numbers.
_Exact = NDArray[np.object_]

ELECTRODES: Final = 8
RADIUS_MM: Final = 50.0
_RINGS: Final = 5
_SPOKES: Final = 2 * ELECTRODES


def small_mesh(radii_mm: Array | None = None) -> Mesh:
    """A disc with eight electrodes of one edge each on its rim, 81 nodes, rings (5,) evenly spaced by default."""
    radii = RADIUS_MM * np.arange(1, _RINGS + 1) / _RINGS if radii_mm is None else radii_mm
    return ring_mesh(radii, _SPOKES, ELECTRODES, 1)


def ring_mesh(radii_mm: Array, spokes: int, electrodes: int, edges_each: int) -> Mesh:
    """A disc of rings of triangles, as many on each ring, with electrodes of some edges each on its rim."""
    angle = 2 * np.pi * np.arange(spokes) / spokes
    ring_nodes_mm = np.stack([np.outer(radii_mm, np.cos(angle)), np.outer(radii_mm, np.sin(angle))], axis=-1).reshape(
        -1, 2
    )
    spoke = np.arange(spokes)
    next_spoke = (spoke + 1) % spokes
    elements = [np.column_stack([np.zeros(spokes, dtype=np.int64), 1 + spoke, 1 + next_spoke])]
    for ring in range(1, len(radii_mm)):
        inner, outer = 1 + (ring - 1) * spokes, 1 + ring * spokes
        elements.append(np.column_stack([inner + spoke, outer + spoke, outer + next_spoke]))
        elements.append(np.column_stack([inner + spoke, outer + next_spoke, inner + next_spoke]))
    rim = 1 + (len(radii_mm) - 1) * spokes
    first_spokes = spokes // electrodes * np.arange(electrodes)
    edges = tuple(
        rim + np.column_stack([k + np.arange(edges_each), k + np.arange(edges_each) + 1]) for k in first_spokes
    )
    return Mesh(np.vstack([[0.0, 0.0], ring_nodes_mm]), np.vstack(elements).astype(np.int64), edges)


@lru_cache(maxsize=1)
def small_model() -> ForwardModel:
    """Homogeneous, with ordinary contacts; made once per process."""
    mesh = small_mesh()
    return ForwardModel(mesh, adjacent_pattern(ELECTRODES), np.ones(len(mesh.elements)), np.full(ELECTRODES, 5.0))


def inclusion(contrast: float) -> Array:
    """Conductances (e,) of the small sheet with a round inclusion of half its radius."""
    away = np.hypot(*small_model().mesh.centroids_mm.T)
    return np.where(away < RADIUS_MM / 2, contrast, 1.0)


def islands(parted: float) -> Array:
    """Good conductors round the electrodes, separated by a poor one that all current must pass."""
    x, y = small_model().mesh.centroids_mm.T
    turn = np.arctan2(y, x) / (2 * np.pi) * ELECTRODES % 1
    return np.where((turn < 0.5) & (np.hypot(x, y) > 30), 1.0, parted)


def scatter_conductance(decades: float, seed: int = 20261121) -> Array:
    """Conductances (e,) whose logarithms are scattered evenly over some decades."""
    random = np.random.default_rng(seed)
    return 10 ** random.uniform(-decades / 2, decades / 2, len(small_model().mesh.elements))


def relative_error(computed: Array, exact: Array, pattern: DrivePattern) -> float:
    """‖V − V*‖/‖V*‖ over the readings that touch no driven electrode."""
    is_usable = pattern.usable()
    return relative_difference(computed[is_usable], exact[is_usable])


def reading_condition(model: ForwardModel, before: Array | None = None) -> float:
    """Relative condition number of the readings for small relative changes of every conductance and contact.

    ‖Σ_e |∂V/∂γ_e| γ_e + Σ_l |∂V/∂z_l| z_l‖ / ‖V‖ (Skeel 1979): the worst effect of one rounding of the data. If
    conductances are given as those ``before`` and a change, both are data.
    """
    is_usable = model.pattern.usable()
    conductance_scale = model.conductance if before is None else before + np.abs(model.conductance - before)
    absolute_terms = np.abs(model.jacobian()[is_usable]) @ conductance_scale
    absolute_terms += np.abs(model.contact_jacobian()[is_usable]) @ model.contact_impedance
    return float(np.linalg.norm(absolute_terms) / np.linalg.norm(model.voltages()[is_usable]))


def exact_readings(
    mesh: Mesh, pattern: DrivePattern, conductance: Array, contact_impedance: Sequence[float] | Array
) -> Array:
    """Readings per unit current (drives, measures) [V/A], solved in fifty digits and rounded once.

    Parameters
    ----------
    mesh : mesh with a few hundred nodes at most; these take a second.
    conductance : (e,) [S]. contact_impedance : (electrodes,) [Ω·mm].
    """
    with mp.workdps(DIGITS):
        potentials = _potentials(mesh, pattern, conductance, contact_impedance)[:, len(mesh.nodes_mm) :]
        readings: Array = (potentials @ pattern.measure_matrix().astype(object)).astype(np.float64)
        return readings


def exact_derivatives(
    mesh: Mesh, pattern: DrivePattern, conductance: Array, contact_impedance: Sequence[float] | Array
) -> tuple[Array, Array]:
    """Change of readings [V/A] per relative change of every conductance and every contact impedance, rounded once.

    γ ∂V_kl/∂γ = −γ ∫∇u_k·∇u_l (drives, drives, e) and z ∂V_kl/∂z = ∫ (U_k − u_k)(U_l − u_l)/z (drives, drives,
    electrodes), for patterns that measure at the pairs they drive.
    """
    with mp.workdps(DIGITS):
        potentials = _potentials(mesh, pattern, conductance, contact_impedance)
        changes = []
        for unknowns, piece in _pieces(mesh, conductance, contact_impedance):
            drops = potentials[:, unknowns] - potentials[:, unknowns[-1:]]  # small compared with the potentials
            changes.append((unknowns, (drops @ piece @ drops.T).astype(np.float64)))
    count, elements = len(mesh.nodes_mm), len(mesh.elements)
    by_contact = np.zeros((len(potentials), len(potentials), len(mesh.electrode_edges)))
    for unknowns, change in changes[elements:]:
        by_contact[:, :, unknowns[-1] - count] += change
    return -np.stack([change for _, change in changes[:elements]], axis=-1), by_contact


def _potentials(
    mesh: Mesh, pattern: DrivePattern, conductance: Array, contact_impedance: Sequence[float] | Array
) -> _Exact:
    """Potentials (drives, nodes, then electrodes) of a unit current through each pair; the last electrode has 0."""
    count, driven = len(mesh.nodes_mm), pattern.drive_currents()
    system = np.full((count + len(driven), count + len(driven)), mp.zero, dtype=object)
    for unknowns, piece in _pieces(mesh, conductance, contact_impedance):
        system[np.ix_(unknowns, unknowns)] += piece
    potentials = np.full((count + len(driven), driven.shape[1]), mp.zero, dtype=object)
    potentials[count:] += driven
    _solve(system[:-1, :-1], potentials[:-1])
    potentials[-1] = mp.zero
    return potentials.T


#: ∫ (u − U)² along an edge over a sixth of its length, in the potentials of its ends and its electrode.
_EDGE: Final = np.array([[2, 1, -3], [1, 2, -3], [-3, -3, 6]], dtype=object)


def _pieces(
    mesh: Mesh, conductance: Array, contact_impedance: Sequence[float] | Array
) -> Iterator[tuple[list[int], _Exact]]:
    """Yield unknowns and matrix of each triangle, then of each electrode's edges.

    A triangle's is γ ∫ ∇φ_i·∇φ_j = γ e_i·e_j / 4A, with e_i the edge opposite corner i.
    """
    places = np.array([[mp.mpf(value) for value in node] for node in mesh.nodes_mm.tolist()], dtype=object)
    for corners, gamma in zip(mesh.elements.tolist(), conductance.tolist(), strict=True):
        opposite = np.roll(places[corners], -2, axis=0) - np.roll(places[corners], -1, axis=0)
        twice = opposite[1, 0] * opposite[2, 1] - opposite[1, 1] * opposite[2, 0]
        yield corners, opposite @ opposite.T * (mp.mpf(gamma) / (2 * twice))
    for number, edges in enumerate(mesh.electrode_edges):
        for first, second in edges.tolist():
            admittance = mp.hypot(*(places[second] - places[first])) / mp.mpf(float(contact_impedance[number]))
            yield [first, second, len(places) + number], _EDGE * (admittance / 6)


def _solve(system: _Exact, right: _Exact) -> None:
    """Replace the right sides (n, k) by the solution; without pivoting, as the system is positive definite."""
    for pivot in range(len(system)):
        rows, columns = (pivot + 1 + np.flatnonzero(line[pivot + 1 :]) for line in (system[:, pivot], system[pivot]))
        factors = system[rows, pivot] / system[pivot, pivot]
        system[np.ix_(rows, columns)] -= np.multiply.outer(factors, system[pivot, columns])
        right[rows] -= np.multiply.outer(factors, right[pivot])
    for pivot in reversed(range(len(system))):
        columns = pivot + 1 + np.flatnonzero(system[pivot, pivot + 1 :])
        right[pivot] = (right[pivot] - system[pivot, columns] @ right[columns]) / system[pivot, pivot]
