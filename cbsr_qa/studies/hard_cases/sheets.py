"""Sheets of the hard cases: the usual sensor as a linear problem, and a small one that fifty digits can be had of.

Readings of the small sheet are solved by the complete electrode model's textbook form (Vauhkonen et al. 1999): first
order, the electrodes' potentials among the unknowns, stiffness from the corners' places. It shares no line with
:mod:`cbsr_qa.eit.forward`, which eliminates those potentials in doubles.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, Final

import numpy as np
from mpmath import mp
from numpy.typing import NDArray

from cbsr_qa.domain.results import ImagingProblem, PreparedReconstruction
from cbsr_qa.domain.sensor import (
    DrivePattern,
    ElectrodeKind,
    ElectrodeLayout,
    Mesh,
    Response,
    SensorType,
    adjacent_pattern,
)
from cbsr_qa.eit.forward import ForwardModel
from cbsr_qa.eit.inverse import imaging_problem
from cbsr_qa.plugin import Kind, Plugins, discover
from cbsr_qa.studies.hard_cases.exact import DIGITS, apart

IMAGE_MM: Final = 6.0


def usual_sensor() -> SensorType:
    """The 100 mm disc with sixteen pins, adjacent drives and measurements."""
    layout = ElectrodeLayout(16, ElectrodeKind.PIN, 48.0, 0.65, 0.0, counterclockwise=True)
    return SensorType("stability", 50.0, 4.0, layout, adjacent_pattern(16), Response.AUTO)


@lru_cache(maxsize=1)
def _plugins() -> Plugins:
    return discover()


def prepared(name: str, problem: ImagingProblem, options: Mapping[str, Any]) -> PreparedReconstruction:
    """Prepare a method that is installed, as ``analyse`` does."""
    method: PreparedReconstruction = _plugins().factory(Kind.RECONSTRUCTION, name)(**options).prepare(problem)
    return method


@lru_cache(maxsize=4)
def usual_problem(kind: str = "whole") -> ImagingProblem:
    """The usual sensor on a coarse image; with three electrodes masked, or noise over twelve decades."""
    sensor = usual_sensor()
    whole = imaging_problem(sensor, image_size_mm=IMAGE_MM)
    if kind == "masked":
        return imaging_problem(sensor, used=without_electrodes(sensor, (2, 7, 12)), image_size_mm=IMAGE_MM)
    if kind == "noisy":
        decades = np.random.default_rng(20261122).permutation(np.linspace(-6, 6, len(whole.reference)))
        return imaging_problem(sensor, noise_variance=0.9 * 10**decades, image_size_mm=IMAGE_MM)
    return whole


def without_electrodes(sensor: SensorType, electrodes: tuple[int, ...]) -> NDArray[np.bool_]:
    """Readings (drives, measures) that touch none of some electrodes."""
    pattern, chosen = sensor.pattern, list(electrodes)
    drives = (pattern.drive_currents()[chosen] != 0).any(axis=0)
    measures = (pattern.measure_matrix()[chosen] != 0).any(axis=0)
    return np.asarray(pattern.usable() & ~drives[:, None] & ~measures, dtype=np.bool_)


Array = NDArray[np.float64]

ELECTRODES: Final = 8
RADIUS_MM: Final = 50.0
_RINGS: Final = 5
_SPOKES: Final = 2 * ELECTRODES


def small_mesh(radii_mm: Array | None = None) -> Mesh:
    """A disc with eight electrodes of one edge each on its rim, 81 nodes.

    Parameters
    ----------
    radii_mm : (5,) of the rings, rising; evenly spaced by default.
    """
    radii = RADIUS_MM * np.arange(1, _RINGS + 1) / _RINGS if radii_mm is None else radii_mm
    return ring_mesh(radii, _SPOKES, ELECTRODES, 1)


def ring_mesh(radii_mm: Array, spokes: int, electrodes: int, edges_each: int) -> Mesh:
    """A disc of rings of triangles, as many on each ring, with electrodes on its rim.

    Parameters
    ----------
    radii_mm : of the rings, rising. spokes : nodes on each. edges_each : of an electrode.
    """
    angle = 2 * np.pi * np.arange(spokes) / spokes
    around = np.stack([np.outer(radii_mm, np.cos(angle)), np.outer(radii_mm, np.sin(angle))], axis=-1).reshape(-1, 2)
    here = np.arange(spokes)
    there = (here + 1) % spokes
    elements = [np.column_stack([np.zeros(spokes, dtype=np.int64), 1 + here, 1 + there])]
    for ring in range(1, len(radii_mm)):
        inner, outer = 1 + (ring - 1) * spokes, 1 + ring * spokes
        elements.append(np.column_stack([inner + here, outer + here, outer + there]))
        elements.append(np.column_stack([inner + here, outer + there, inner + there]))
    rim = 1 + (len(radii_mm) - 1) * spokes
    first = spokes // electrodes * np.arange(electrodes)
    edges = tuple(rim + np.column_stack([k + np.arange(edges_each), k + np.arange(edges_each) + 1]) for k in first)
    return Mesh(np.vstack([[0.0, 0.0], around]), np.vstack(elements).astype(np.int64), edges)


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
    """Good conductors round the electrodes, parted by a poor one that all current has to pass."""
    x, y = small_model().mesh.centroids_mm.T
    turn = np.arctan2(y, x) / (2 * np.pi) * ELECTRODES % 1
    return np.where((turn < 0.5) & (np.hypot(x, y) > 30), 1.0, parted)


def scattered(decades: float, seed: int = 20261121) -> Array:
    """Conductances (e,) whose logarithms are scattered evenly over some decades."""
    random = np.random.default_rng(seed)
    values: Array = 10 ** random.uniform(-decades / 2, decades / 2, len(small_model().mesh.elements))
    return values


def relative_error(computed: Array, exact: Array, pattern: DrivePattern) -> float:
    """‖V − V*‖/‖V*‖ over the readings that touch no driven electrode."""
    used = pattern.usable()
    return apart(computed[used], exact[used])


def reading_condition(model: ForwardModel, before: Array | None = None) -> float:
    """Relative condition number of the readings for small relative changes of every conductance and contact.

    ‖Σ_e |∂V/∂γ_e| γ_e + Σ_l |∂V/∂z_l| z_l‖ / ‖V‖ (Skeel 1979): what one rounding of the data does at worst.

    Parameters
    ----------
    model : of the readings.
    before : (e,) where conductances are given as these and a change of them; both are data then.
    """
    used = model.pattern.usable()
    given = model.conductance if before is None else before + np.abs(model.conductance - before)
    felt = np.abs(model.jacobian()[used]) @ given
    felt += np.abs(model.contact_jacobian()[used]) @ model.contact_impedance
    return float(np.linalg.norm(felt) / np.linalg.norm(model.voltages()[used]))


#: Symmetric matrix as rows of its entries, both triangles.
_Rows = list[dict[int, Any]]


def exact_readings(
    mesh: Mesh, pattern: DrivePattern, conductance: Array, contact_impedance: Sequence[float] | Array
) -> Array:
    """Readings per unit current, solved in fifty digits and rounded once.

    Parameters
    ----------
    mesh : of some hundred nodes at most: a second of time.
    conductance : (e,) [S]. contact_impedance : (electrodes,) [Ω·mm].

    Returns
    -------
    (drives, measures) float64 [V/A].
    """
    with mp.workdps(DIGITS):
        potentials, places = _potentials(mesh, pattern, conductance, contact_impedance), len(mesh.nodes_mm)
        measured = pattern.measure_matrix()
        readings = np.zeros(pattern.shape)
        for drive, potential in enumerate(potentials):
            for measure in range(measured.shape[1]):
                touched = np.flatnonzero(measured[:, measure])
                readings[drive, measure] = float(
                    mp.fsum(mp.mpf(measured[k, measure]) * potential[places + int(k)] for k in touched)
                )
    return readings


def exact_derivatives(
    mesh: Mesh, pattern: DrivePattern, conductance: Array, contact_impedance: Sequence[float] | Array
) -> tuple[Array, Array]:
    """Change of readings per relative change of every conductance and every contact impedance, rounded once.

    γ ∂V_kl/∂γ = −γ ∫∇u_k·∇u_l and z ∂V_kl/∂z = ∫ (U_k − u_k)(U_l − u_l)/z, for patterns that measure at the pairs
    they drive.

    Returns
    -------
    (drives, drives, e) and (drives, drives, electrodes) float64 [V/A].
    """
    count = len(mesh.nodes_mm)
    with mp.workdps(DIGITS):
        potentials = _potentials(mesh, pattern, conductance, contact_impedance)
        pairs = [(drive, measure) for drive in range(len(potentials)) for measure in range(drive + 1)]
        places = [[mp.mpf(float(value)) for value in node] for node in mesh.nodes_mm]
        by_element = np.zeros((len(potentials), len(potentials), len(mesh.elements)))
        for number, (corners, gamma) in enumerate(zip(mesh.elements.tolist(), conductance.tolist(), strict=True)):
            fields = [
                _gradient([places[c] for c in corners], [potential[c] for c in corners]) for potential in potentials
            ]
            for drive, measure in pairs:
                (ax, ay, area), (bx, by, _) = fields[drive], fields[measure]
                by_element[drive, measure, number] = by_element[measure, drive, number] = float(
                    -mp.mpf(gamma) * (ax * bx + ay * by) * area
                )
        by_contact = np.zeros((len(potentials), len(potentials), len(mesh.electrode_edges)))
        for number, edges in enumerate(mesh.electrode_edges):
            for ends in edges.tolist():
                (ax, ay), (bx, by) = (places[end] for end in ends)
                length = mp.sqrt((ax - bx) ** 2 + (ay - by) ** 2) / mp.mpf(float(contact_impedance[number]))
                drops = [[potential[count + number] - potential[end] for end in ends] for potential in potentials]
                for drive, measure in pairs:
                    (a, b), (c, d) = drops[drive], drops[measure]
                    by_contact[drive, measure, number] += float(length * (2 * a * c + 2 * b * d + a * d + b * c) / 6)
                    by_contact[measure, drive, number] = by_contact[drive, measure, number]
    return by_element, by_contact


def _potentials(
    mesh: Mesh, pattern: DrivePattern, conductance: Array, contact_impedance: Sequence[float] | Array
) -> list[list[Any]]:
    """Potentials of nodes, then electrodes, for a unit current through each drive pair."""
    rows = _assembled(mesh, conductance, contact_impedance)
    count, electrodes = len(mesh.nodes_mm), len(mesh.electrode_edges)
    ground = count + electrodes - 1  # the last electrode's potential is zero
    _drop(rows, ground)
    driven = pattern.drive_currents()
    loads = [{count + k: mp.mpf(driven[k, d]) for k in range(electrodes - 1)} for d in range(driven.shape[1])]
    return [
        [solution.get(unknown, mp.zero) for unknown in range(ground + 1)] for solution in _solved(rows, loads, ground)
    ]


def _gradient(places: Sequence[Sequence[Any]], values: Sequence[Any]) -> tuple[Any, Any, Any]:
    """Gradient of a linear function on a triangle, and the triangle's area."""
    (ax, ay), (bx, by) = ([places[k][axis] - places[0][axis] for axis in (0, 1)] for k in (1, 2))
    along, across, twice = values[1] - values[0], values[2] - values[0], ax * by - ay * bx
    return (along * by - across * ay) / twice, (across * ax - along * bx) / twice, twice / 2


def _assembled(mesh: Mesh, conductance: Array, contact_impedance: Sequence[float] | Array) -> _Rows:
    count = len(mesh.nodes_mm)
    rows: _Rows = [{} for _ in range(count + len(mesh.electrode_edges))]
    places = [[mp.mpf(float(value)) for value in node] for node in mesh.nodes_mm]
    for corners, gamma in zip(mesh.elements.tolist(), conductance.tolist(), strict=True):
        _add_element(rows, corners, [places[corner] for corner in corners], mp.mpf(gamma))
    for number, edges in enumerate(mesh.electrode_edges):
        impedance = mp.mpf(float(contact_impedance[number]))
        for first, second in edges.tolist():
            (ax, ay), (bx, by) = places[first], places[second]
            _add_contact(rows, first, second, count + number, mp.sqrt((ax - bx) ** 2 + (ay - by) ** 2) / impedance)
    return rows


def _add_element(rows: _Rows, corners: Sequence[int], places: Sequence[Sequence[Any]], gamma: Any) -> None:
    """γ ∫ ∇φ_i·∇φ_j = γ e_i·e_j / 4A with e_i the edge opposite corner i."""
    opposite = [[places[(i + 2) % 3][axis] - places[(i + 1) % 3][axis] for axis in (0, 1)] for i in range(3)]
    twice = opposite[1][0] * opposite[2][1] - opposite[1][1] * opposite[2][0]
    for i in range(3):
        for j in range(3):
            dot = opposite[i][0] * opposite[j][0] + opposite[i][1] * opposite[j][1]
            _add(rows, corners[i], corners[j], gamma * dot / (2 * twice))


def _add_contact(rows: _Rows, first: int, second: int, electrode: int, admittance: Any) -> None:
    """∫ (u − U)² / z along an edge, where ``admittance`` is its length over z."""
    for row, column, share in (
        (first, first, 3), (second, second, 3), (first, second, 6), (second, first, 6),
        (first, electrode, -2), (electrode, first, -2), (second, electrode, -2), (electrode, second, -2),
        (electrode, electrode, 1),
    ):  # fmt: skip
        _add(rows, row, column, admittance / share)


def _add(rows: _Rows, row: int, column: int, value: Any) -> None:
    rows[row][column] = rows[row].get(column, mp.zero) + value


def _drop(rows: _Rows, unknown: int) -> None:
    for other in rows[unknown]:
        if other != unknown:
            del rows[other][unknown]
    rows[unknown] = {}


def _solved(rows: _Rows, loads: list[dict[int, Any]], ground: int) -> list[dict[int, Any]]:
    """Eliminate by least degree, without pivots: the matrix is positive definite."""
    left = set(range(len(rows))) - {ground}
    steps: list[tuple[int, dict[int, Any], Any]] = []
    while left:
        pivot = min(left, key=lambda unknown: (len(rows[unknown]), unknown))
        left.discard(pivot)
        row = rows[pivot]
        diagonal = row.pop(pivot)
        for other in row:
            del rows[other][pivot]
        for one, value in row.items():
            factor = value / diagonal
            target = rows[one]
            for other, entry in row.items():
                target[other] = target.get(other, mp.zero) - factor * entry
            for load in loads:
                if load.get(pivot):
                    load[one] = load.get(one, mp.zero) - factor * load[pivot]
        steps.append((pivot, row, diagonal))
    solutions: list[dict[int, Any]] = [{} for _ in loads]
    for pivot, row, diagonal in reversed(steps):
        for load, answer in zip(loads, solutions, strict=True):
            rest = mp.fsum(entry * answer[other] for other, entry in row.items())
            answer[pivot] = (load.get(pivot, mp.zero) - rest) / diagonal
    return solutions
