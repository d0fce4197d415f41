"""A problem in pyEIT's words: its mesh, its point electrodes, its protocol; and its images on our mesh.

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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.reconstruction import ImagingProblem, LinearReconstruction, ParameterChoice
from cbsr_qa.reconstruct.dual import check_hyperparameter
from cbsr_qa.reconstruct.noise_figure import noise_figure
from cbsr_qa.reconstruct.options import number
from cbsr_qa.reconstruct.problem import target_signal

Array = NDArray[np.float64]

_REMEDY = "pip install 'cbsr-qa[pyeit]'"
_SIZES = (0.02, 0.2)  # edge lengths its mesher is used with, of the radius: 18 000 to 170 elements
_MOST_CONDITION = 1e12  # its inverse has four digits then
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


def checked_options(method: str, *, p: float, lamb: float, mesh_size: float) -> tuple[float, float, float]:
    """Return p, lamb and mesh_size; refuse what pyEIT would take and answer with noise, and that pyEIT is missing."""
    _module("pyeit")
    p, lamb, mesh_size = (
        number(method, name, value) for name, value in (("p", p), ("lamb", lamb), ("mesh_size", mesh_size))
    )
    if not _SIZES[0] <= mesh_size <= _SIZES[1]:
        raise NumericsError(
            f"mesh_size is {mesh_size}; pyEIT is used with {_SIZES[0]} to {_SIZES[1]} of the radius",
            remedy="give a size in that range; 0.07 is usual",
        )
    check_hyperparameter(lamb)
    if lamb == 0:
        raise NumericsError("lamb is 0: pyEIT would invert a singular matrix", remedy="give a value above zero")
    if not 0 <= p <= 1:
        raise NumericsError(f"p is {p}; it must be in 0 … 1", remedy="give a p in that range; 0.5 is usual")
    return p, lamb, mesh_size


def pyeit_problem(problem: ImagingProblem, mesh_size: float) -> PyeitProblem:
    """Put a problem into pyEIT's words.

    Raises
    ------
    NumericsError
        If the sheet is not round, or a used reading touches a driven electrode: between point electrodes that
        voltage has no value but the mesh's.
    """
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

    Raises
    ------
    NumericsError
        If the condition number, against R, may be above 1e12.
    """
    least = float((squares ** (1 - p)).sum()) / _MOST_CONDITION
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


def finished(method: str, problem: ImagingProblem, matrix: Array, regularisation: float) -> LinearReconstruction:
    """Wrap an imaging matrix on our mesh, with its noise figure.

    Raises
    ------
    NumericsError
        If pyEIT's matrix is not finite.
    """
    if not np.isfinite(matrix).all():
        raise NumericsError("pyEIT's matrix is not finite", remedy="give a larger lamb")
    radius = _TARGET_RADIUS * problem.sensor_type.radius_mm
    signal = target_signal(problem, x_mm=0, y_mm=0, radius_mm=radius, contrast=_TARGET_CONTRAST)
    figure = noise_figure(matrix, signal, problem.mesh.areas_mm2, noise_variance=problem.noise_variance)
    choice = ParameterChoice(
        regularisation, "given; pyEIT does not choose it", figure, "pyEIT's lamb", criterion="given"
    )
    return LinearReconstruction(method, problem, matrix, choice)


def solver(name: str, given: PyeitProblem) -> Any:
    """Make one of pyEIT's solvers, not yet set up, by ``module:class``."""
    module, _, attribute = name.partition(":")
    with quiet():
        return getattr(_module(module), attribute)(given.mesh, given.protocol)


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
