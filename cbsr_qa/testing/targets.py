"""Targets and the blobs images make of them, a problem that is exactly symmetric, and images of a fresh process.

Meshes of sensor types come near to the electrodes' symmetry only: here rings of nodes are joined by hand, and
voltages and images share the mesh.
"""

import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.imaging import ImagingProblem, PreparedReconstruction
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import Response, SensorType
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.inverse.problem import imaging_problem, target_signal
from cbsr_qa.plugin.interfaces import Reconstruction
from cbsr_qa.testing.checked import demand

Factory = Callable[[], Reconstruction]

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_POLITE = {"OPENBLAS_THREAD_TIMEOUT": "4"}  # idle threads sleep at once: others may need the core
_COMMAND = "import sys; from cbsr_qa.testing.targets import answer; answer(sys.argv[1])"


def images_elsewhere(
    factories: Sequence[Factory], problem: ImagingProblem, changes: Array, *, threads: int
) -> list[Array]:
    """Prepare and image in one fresh process.

    Parameters
    ----------
    factories : classes or functions a module holds by name, or partials of such.
    changes : (n, m), as ``PreparedReconstruction.images`` takes them.
    threads : of the numerical libraries there.

    Returns
    -------
    One (n, e) float64 for each factory.

    Raises
    ------
    RefusedError
        If a factory cannot be found by name from another process, or that process fails; quotes its output.
    """
    with tempfile.TemporaryDirectory() as folder:
        try:
            (Path(folder) / "asked").write_bytes(pickle.dumps((list(factories), problem, changes)))
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise RefusedError(
                f"another process cannot be asked: {error}",
                remedy="use a class or function that a module holds by name",
            ) from error
        environment = os.environ | dict.fromkeys(_THREADS, str(threads)) | _POLITE | {"PYTHONHASHSEED": str(threads)}
        environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
        done = subprocess.run(
            [sys.executable, "-c", _COMMAND, folder], env=environment, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise RefusedError(f"the other process failed: {done.stderr.strip()}")
        answered: list[Array] = pickle.loads((Path(folder) / "answered").read_bytes())
        return answered


def answer(folder: str) -> None:
    """Carry out the request in a folder; called in the other process."""
    factories, problem, changes = pickle.loads((Path(folder) / "asked").read_bytes())
    images = [factory().prepare(problem).images(changes) for factory in factories]
    (Path(folder) / "answered").write_bytes(pickle.dumps(images))


_RADIUS_MM = 50.0
_ELECTRODES = 16
_RINGS = 8
_RIM = 4 * _ELECTRODES  # edges along the rim: four for every electrode, of which it covers two
_CONTACT_MM = 0.5  # contact impedance times sheet conductance


@dataclass(frozen=True, slots=True, eq=False)
class SymmetricProblem:
    """A problem on one mesh, and the element (e,) that each one comes to lie on after a turn by one electrode."""

    problem: ImagingProblem
    turned: Indices

    def turn_readings(self, readings: Array) -> Array:
        """Readings (m,) of the same target one electrode further."""
        frame = np.zeros(self.problem.used.shape)
        frame[self.problem.used] = readings
        return np.roll(frame, (1, 1), axis=(0, 1))[self.problem.used]

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
    return SymmetricProblem(problem, _rotate_elements(mesh))


def _mesh() -> Mesh:
    counts = [1]
    for ring in range(1, _RINGS + 1):
        # The number of electrodes, doubled until edges are about as long as on the rim.
        doublings = max(0, round(np.log2(_RIM / _ELECTRODES * ring / _RINGS)))
        counts.append(int(_ELECTRODES * 2**doublings))
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


def _rotate_elements(mesh: Mesh) -> Indices:
    angle = 2 * np.pi / _ELECTRODES
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    nearest = cKDTree(mesh.centroids_mm).query(mesh.centroids_mm @ turn.T)
    distance, turned = np.asarray(nearest[0]), np.asarray(nearest[1], dtype=np.int64)
    if distance.max() > 1e-9 * _RADIUS_MM or len(np.unique(turned)) < len(turned):
        raise AssertionError("the mesh is not the same after a turn by one electrode")
    return turned


#: Where targets are, in units of the sheet's radius.
PLACES = ((0.1, 0.05), (0.5, 0.2), (-0.4, 0.3), (-0.1, -0.55))
CONTRAST = 0.2

_TARGET_RADIUS = 0.13  # of the sheet's radius: the 13 mm indenter on the 100 mm disc
_BLOB = 0.5  # an image's blob is what exceeds this share of its maximum
_NOISE = 1e-3  # of a reading: 60 dB


def example_problem(*, used: Mask | None = None) -> ImagingProblem:
    """Return the shipped 100 mm disc on a coarse image mesh, with reference readings of an ideal sensor."""
    problem = imaging_problem(load_sensor_type("disc-100mm").value, used=used, image_size_mm=6.0)
    return replace(problem, measured=problem.reference)


def noise_deviation(problem: ImagingProblem) -> Array:
    """Standard deviation of readings with 60 dB, (m,)."""
    return _NOISE * np.abs(problem.reference)


def noise(problem: ImagingProblem, random: np.random.Generator, frames: int) -> Array:
    """Frames of noise at 60 dB, (frames, m)."""
    deviation = noise_deviation(problem)
    return deviation * random.standard_normal((frames, len(deviation)))


def signal(problem: ImagingProblem, at: tuple[float, float], contrast: float) -> Array:
    """Change of readings (m,) by an indenter-sized target of contrast Δγ/γ₀; ``at`` in units of the radius."""
    radius = problem.sensor_type.radius_mm
    return target_signal(
        problem, x_mm=at[0] * radius, y_mm=at[1] * radius, radius_mm=_TARGET_RADIUS * radius, contrast=contrast
    )


def locate_target(prepared: PreparedReconstruction, at: tuple[float, float], contrast: float) -> Array:
    """Centre [mm] of the blob a target makes, (2,).

    Raises
    ------
    AssertionError
        If the image is empty, or the blob has the other sign.
    """
    image = prepared.images(signal(prepared.problem, at, contrast)[None])[0]
    check_image(prepared, image)
    own_sign = bool(np.sign(contrast) * (image.max() + image.min()) > 0)
    demand(prepared, own_sign, f"answers a target of {contrast:+.0%} at {at} of the radius with the other sign")
    return blob_centre(prepared, np.sign(contrast) * image)


def check_image(prepared: PreparedReconstruction, image: Array) -> None:
    """Assert that an image has a finite value on each element of its mesh."""
    elements = len(prepared.problem.mesh.elements)
    demand(prepared, image.shape == (elements,), f"makes images of shape {image.shape} on {elements} elements")
    demand(prepared, bool(np.isfinite(image).all()), "makes an image that is not finite")


def blob_centre(prepared: PreparedReconstruction, image: Array) -> Array:
    """Centre of mass [mm] of what an image has above half its maximum, (2,).

    Half the maximum is subtracted, so that an element at the threshold does not make the centre jump.
    """
    mesh = prepared.problem.mesh
    weights = np.maximum(image - _BLOB * image.max(), 0) * mesh.areas_mm2
    centre: Array = weights @ mesh.centroids_mm / weights.sum()
    return centre
