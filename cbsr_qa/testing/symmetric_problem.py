"""A coarse imaging problem that is exactly the same after a turn by one electrode.

Meshes of a sensor type are filled by a smoothing iteration and come near to the electrodes' symmetry only. Here rings
of nodes are joined by hand, and voltages and images share the mesh: what a method does to the symmetry is its own.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cbsr_qa.domain.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.patterns import adjacent_pattern
from cbsr_qa.domain.reconstruction import ImagingProblem
from cbsr_qa.domain.sensor import Response, SensorType
from cbsr_qa.forward.model import ForwardModel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_RADIUS_MM = 50.0
_ELECTRODES = 16
_RINGS = 8
_RIM = 4 * _ELECTRODES  # edges along the rim: four for every electrode, of which it covers two
_CONTACT_MM = 0.5  # contact impedance times sheet conductance


@dataclass(frozen=True, slots=True, eq=False)
class SymmetricProblem:
    """A problem and what a turn by one electrode does to it.

    Parameters
    ----------
    problem : voltages and images on one mesh.
    turned : (e,) int64, the element each element comes to lie on.
    """

    problem: ImagingProblem
    turned: Indices

    def turn_readings(self, readings: Array) -> Array:
        """Readings (m,) of the same target one electrode further."""
        frame = np.zeros(self.problem.used.shape)
        frame[self.problem.used] = readings
        turned: Array = np.roll(frame, (1, 1), axis=(0, 1))[self.problem.used]
        return turned

    def turn_image(self, image: Array) -> Array:
        """Image (e,) one electrode further."""
        turned = np.empty_like(image)
        turned[self.turned] = image
        return turned


@lru_cache(maxsize=1)
def symmetric_problem() -> SymmetricProblem:
    """A 100 mm disc with 16 arc electrodes, about 700 elements; made once per process."""
    mesh = _mesh()
    width_mm = 2 * np.pi * _RADIUS_MM / _RIM * 2
    layout = ElectrodeLayout(_ELECTRODES, ElectrodeKind.ARC, _RADIUS_MM, width_mm, 0.0, counterclockwise=True)
    sensor = SensorType("symmetric disc", _RADIUS_MM, 4.0, layout, adjacent_pattern(_ELECTRODES), Response.AUTO)
    model = ForwardModel(mesh, sensor.pattern, np.ones(len(mesh.elements)), np.full(_ELECTRODES, _CONTACT_MM))
    used = sensor.pattern.usable()
    reference = model.voltages()[used]
    problem = ImagingProblem(sensor, mesh, model.jacobian()[used], reference, used, measured=reference)
    return SymmetricProblem(problem, _turned(mesh))


def _mesh() -> Mesh:
    counts = [1, *(_on_ring(ring) for ring in range(1, _RINGS + 1))]
    starts = np.concatenate([[0], np.cumsum(counts)])
    radii = _RADIUS_MM * np.arange(_RINGS + 1) / _RINGS
    angles = [2 * np.pi * np.arange(count) / count for count in counts]
    nodes = np.vstack(
        [r * np.column_stack([np.cos(angle), np.sin(angle)]) for r, angle in zip(radii, angles, strict=True)]
    )
    elements = [
        _strip(starts[ring], counts[ring], starts[ring + 1], counts[ring + 1]) for ring in range(len(counts) - 1)
    ]
    first = _RIM // _ELECTRODES * np.arange(_ELECTRODES)
    edges = tuple(starts[-2] + np.array([[k - 1, k], [k, k + 1]]) % _RIM for k in first)
    return Mesh(nodes, np.vstack(elements), edges)


def _on_ring(ring: int) -> int:
    """Nodes on a ring: the electrodes' number, doubled as often as keeps the edges about as long as on the rim."""
    doublings = max(0, round(np.log2(_RIM / _ELECTRODES * ring / _RINGS)))
    return int(_ELECTRODES * 2**doublings)


def _strip(inner: int, inner_count: int, outer: int, outer_count: int) -> Indices:
    """Triangles between two rings, of which the outer has as many nodes as the inner one or twice as many."""
    here = np.arange(max(outer_count, inner_count))
    there = (here + 1) % outer_count
    if inner_count == 1:
        return np.column_stack([np.full(outer_count, inner), outer + here, outer + there])
    ratio = outer_count // inner_count
    near, next_near = inner + here // ratio, inner + (here // ratio + 1) % inner_count
    outward = np.column_stack([near, outer + here, outer + there])
    if ratio == 1:
        return np.vstack([outward, np.column_stack([near, outer + there, next_near])])
    # Of the two fine edges beyond a coarse one the second is joined to its far end; one triangle fills the gap.
    second = here % 2 == 1
    outward[second, 0] = next_near[second]
    middle = here[~second]
    return np.vstack([outward, np.column_stack([near[~second], outer + middle + 1, next_near[~second]])])


def _turned(mesh: Mesh) -> Indices:
    angle = 2 * np.pi / _ELECTRODES
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    found = cKDTree(mesh.centroids_mm).query(mesh.centroids_mm @ turn.T)
    distance, turned = np.asarray(found[0]), np.asarray(found[1], dtype=np.int64)
    if distance.max() > 1e-9 * _RADIUS_MM or len(np.unique(turned)) < len(turned):
        raise AssertionError("the mesh is not the same after a turn by one electrode")
    return turned
