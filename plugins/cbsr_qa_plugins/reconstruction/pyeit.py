"""pyEIT's JAC and GREIT, for comparison: its mesh, point electrodes and protocol; its images on our mesh.

pyEIT solves on the unit disc at unit conductivity. Readings of point electrodes in two dimensions do not depend on
the radius, so its Jacobian has our unit, with the sign turned: its images are −H·(v − v₀).
"""

import contextlib
import io
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field
from scipy import sparse

from cbsr_qa.domain.numbers import Array
from cbsr_qa.eit.inverse.noise_figures import noise_figure
from cbsr_qa.eit.inverse.overlap import overlap_fractions
from cbsr_qa.eit.inverse.problem import target_signal
from cbsr_qa.plugin import (
    ImagingProblem,
    LinearReconstruction,
    Mesh,
    NumericsError,
    ParameterChoice,
    PluginOptions,
    WithOptions,
)

_REMEDY = "pip install 'cbsr-qa[pyeit]'"
_MAX_CONDITION = 1e12  # its inverse has four digits then
_TARGET_RADIUS = 0.13  # of the sheet's radius: the 13 mm indenter on the 100 mm disc
_TARGET_CONTRAST = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class PyeitProblem:
    """What pyEIT's solvers take, and its mesh in ours.

    Parameters
    ----------
    mesh : ``PyEITMesh`` on the unit disc; its first nodes are the electrodes.
    protocol : ``PyEITProtocol`` of the used readings, in their order.
    elements : the same triangles [mm].
    """

    mesh: Any
    protocol: Any
    elements: Mesh


class PyeitOptions(PluginOptions):
    """Options of all of pyEIT's methods: what it would take and answer with noise is refused."""

    p: Annotated[float, Field(ge=0, le=1)] = 0.5
    lamb: Annotated[float, Field(gt=0, le=1e50)] = 0.01
    #: Edge lengths its mesher is used with, of the radius: 18 000 to 170 elements.
    mesh_size: Annotated[float, Field(ge=0.02, le=0.2)] = 0.07


class _PyeitMethod(WithOptions):
    """Refused if pyEIT is not installed."""

    Options: ClassVar[type[PluginOptions]] = PyeitOptions
    options: PyeitOptions
    weighs_noise = False

    def __init__(self, **options: Any) -> None:
        _module("pyeit")
        super().__init__(**options)


def pyeit_problem(problem: ImagingProblem, mesh_size: float) -> PyeitProblem:
    """Convert a problem for pyEIT."""
    sensor = problem.sensor_type
    if sensor.polygon is not None:
        raise NumericsError(
            f"sensor type {sensor.name!r} is not round; pyEIT is compared on discs only",
            remedy="take a reconstruction of this package",
        )
    if (problem.used & ~sensor.pattern.usable()).any():
        raise NumericsError(
            "pyEIT's point electrodes have no voltage while they are driven",
            remedy="leave readings that touch a driven electrode out of the problem (`used`)",
        )
    places = sensor.electrodes.positions_mm() / sensor.radius_mm
    with quiet():
        mesh = _mesh(places.tobytes(), len(places), mesh_size)
        protocol = _protocol(problem)
    nodes = sensor.radius_mm * np.asarray(mesh.node, dtype=np.float64)[:, :2]
    return PyeitProblem(mesh, protocol, Mesh(nodes, np.asarray(mesh.element, dtype=np.int64)))


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Let pyEIT print, warn and draw from numpy's common generator without anybody noticing."""
    state = np.random.get_state()  # noqa: NPY002 - its mesher draws from it
    try:
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        np.random.set_state(state)  # noqa: NPY002


def check_determined(squares: Array, p: float, lamb: float) -> None:
    """Refuse lamb that is lost in rounding when pyEIT inverts JᵀJ + lamb·R, or JJᵀ + lamb·R: both are singular.

    Parameters
    ----------
    squares : diagonal of JᵀJ or JJᵀ, whose p-th powers are R.
    """
    least = float((squares ** (1 - p)).sum()) / _MAX_CONDITION
    if not lamb >= least:
        raise NumericsError(
            f"lamb is {lamb:.3g}, too small: rounding would decide pyEIT's image",
            remedy=f"give a lamb of at least {least:.1e}",
        )


@contextlib.contextmanager
def invertible() -> Iterator[None]:
    """Refuse by name what pyEIT cannot invert."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise NumericsError("pyEIT's matrix is singular", remedy="give a larger lamb") from error


def wrap_matrix(method: str, problem: ImagingProblem, matrix: Array, regularisation: float) -> LinearReconstruction:
    """Wrap an imaging matrix on our mesh, with its noise figure."""
    if not np.isfinite(matrix).all():
        raise NumericsError("pyEIT's matrix is not finite", remedy="give a larger lamb")
    radius = _TARGET_RADIUS * problem.sensor_type.radius_mm
    signal = target_signal(problem, x_mm=0, y_mm=0, radius_mm=radius, contrast=_TARGET_CONTRAST)
    figure = noise_figure(matrix, signal, problem.mesh.areas_mm2, noise_variance=problem.noise_variance)
    choice = ParameterChoice(
        regularisation, "given; pyEIT does not choose it", figure, "pyEIT's lamb", criterion="given"
    )
    return LinearReconstruction(method, problem, matrix, choice)


def solver(name: str, pyeit_problem: PyeitProblem) -> Any:
    """Make one of pyEIT's solvers, not yet set up, by ``module:class``."""
    module, _, attribute = name.partition(":")
    with quiet():
        return getattr(_module(module), attribute)(pyeit_problem.mesh, pyeit_problem.protocol)


def _module(name: str) -> Any:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return import_module(name)
    except ImportError as error:
        raise NumericsError(f"pyEIT cannot be used here: {error}", remedy=_REMEDY) from error


@lru_cache(maxsize=4)
def _mesh(places: bytes, count: int, mesh_size: float) -> Any:
    fixed = np.frombuffer(places).reshape(count, 2)
    return _module("pyeit.mesh").create(count, h0=mesh_size, p_fix=fixed)


def _protocol(problem: ImagingProblem) -> Any:
    """Used readings drive by drive; one by one where drives have different numbers of them: pyEIT knows no masks."""
    pattern = problem.sensor_type.pattern
    counts = problem.used.sum(axis=1)
    driven = np.flatnonzero(counts)
    drive, measure = np.argwhere(problem.used).T
    drives = driven if len(set(counts[driven])) == 1 else drive
    measured = np.array(pattern.measure)[measure].reshape(len(drives), -1, 2)
    return _module("pyeit.eit.protocol").PyEITProtocol(
        np.array(pattern.drive)[drives], measured, np.ones(len(measure), dtype=bool)
    )


class PyeitJac(_PyeitMethod):
    """x = (JᵀJ + lamb·diag(JᵀJ)^p)⁻¹Jᵀ y as pyEIT 1.2.4 computes it, on its own mesh with point electrodes.

    Each of our elements takes the mean of the triangles of pyEIT's mesh it lies in, weighed by area.

    Parameters
    ----------
    p, lamb : pyEIT's, by default as in its examples.
    mesh_size : edge length of pyEIT's mesh, of the radius; 0.07 gives about 1400 elements and readings within 0.5 %.
        It inverts a matrix as large as their number.
    """

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        converted = pyeit_problem(problem, self.options.mesh_size)
        jac = solver("pyeit.eit.jac:JAC", converted)
        with quiet(), invertible():
            jac.setup(p=self.options.p, lamb=self.options.lamb, method="kotre", perm=1, jac_normalized=False)
        check_determined(np.einsum("me,me->e", jac.J, jac.J), self.options.p, self.options.lamb)
        share = overlap_fractions(problem.mesh, converted.elements)
        return wrap_matrix("pyeit-jac", problem, -(share @ np.asarray(jac.H, dtype=np.float64)), self.options.lamb)


_NAME = "pyeit-greit"


class PyeitGreit(_PyeitMethod):
    """pyEIT 1.2.4's GREIT ("distribution method", no training targets) on a raster, with point electrodes.

    It gives values at the points of its raster; our elements interpolate linearly between them, at their centroids.

    Parameters
    ----------
    p, lamb, s, ratio : pyEIT's, by default as in its examples; ``ratio`` is the radius of its blur, of the largest
        distance on the raster, ``s`` how sharply the blur ends.
    n : points of the raster along each side.
    mesh_size : edge length of pyEIT's mesh, of the radius; 0.07 gives about 1400 elements and readings within 0.5 %.
    """

    class Options(PyeitOptions):
        n: Annotated[int, Field(ge=8, le=256)] = 32
        s: Annotated[float, Field(gt=0, lt=1e3)] = 20.0
        ratio: Annotated[float, Field(gt=0, lt=1)] = 0.1

    options: Options

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        converted = pyeit_problem(problem, self.options.mesh_size)
        greit = solver("pyeit.eit.greit:GREIT", converted)
        with quiet(), invertible():
            greit.setup(method="dist", perm=1, jac_normalized=False, **self.options.model_dump(exclude={"mesh_size"}))
        check_determined(np.einsum("me,me->m", greit.J, greit.J), self.options.p, self.options.lamb)
        x, y = np.asarray(greit.xg)[0], np.asarray(greit.yg)[:, 0]
        between = _interpolate_raster(x, y, problem.mesh.centroids_mm / problem.sensor_type.radius_mm)
        return wrap_matrix(_NAME, problem, -(between @ np.asarray(greit.H, dtype=np.float64)), self.options.lamb)


def _interpolate_raster(x: Array, y: Array, points: Array) -> sparse.csr_matrix:
    """Bilinear interpolation from a raster (rows y, columns x) to points (k, 2): (k, pixels) sparse.

    Points beyond the raster take its edge; pyEIT's ends one step before the disc does.
    """
    places = []
    for axis, along in ((x, points[:, 0]), (y, points[:, 1])):
        positions = np.clip((along - axis[0]) / (axis[1] - axis[0]), 0, len(axis) - 1)
        low = np.minimum(positions.astype(np.int64), len(axis) - 2)
        places.append((low, positions - low))
    (column, right), (row, up) = places
    corners = [(row + i) * len(x) + column + j for i in (0, 1) for j in (0, 1)]
    weights = [(up if i else 1 - up) * (right if j else 1 - right) for i in (0, 1) for j in (0, 1)]
    index = np.tile(np.arange(len(points)), 4)
    entries = (np.concatenate(weights), (index, np.concatenate(corners)))
    return sparse.csr_matrix(entries, shape=(len(points), len(x) * len(y)))
