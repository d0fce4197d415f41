"""Images: effect of methods, smoothing and mesh density on the places of loads, and their cost in time.

For imaging matrices: digits lost and time saved by single precision and large blocks of frames.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, Final, get_type_hints
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import CbsrError, NumericsError
from cbsr_qa.domain.imaging import ImagingProblem, LinearReconstruction, PreparedReconstruction, linear
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.inverse.problem import image_jacobian, imaging_problem, nominal_model
from cbsr_qa.eit.mesh.sheet import image_mesh
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import Reconstruction
from cbsr_qa.plugin.options import options_of
from cbsr_qa.studies.frontier.computer.forward import REPEATS, fastest_s, time_call
from cbsr_qa.studies.frontier.computer.readings import base_scene_readings, figures_of_merit, sensor_changes
from cbsr_qa.studies.frontier.point import Accuracy, Knob, Point, TimeBasis

Floats = NDArray[np.floating[Any]]

SERIES_PRECISION: Final = "applying the matrix"
SERIES_METHODS: Final = "reconstruction"
SERIES_MESHES: Final = "image mesh"  # and the method's name

#: λ relative to a method's own choice; for a count of components likewise.
FACTORS: Final[Mapping[str, tuple[float, ...]]] = {
    "hyperparameter": (0.03, 0.1, 0.3, 3.0, 10.0, 30.0),
    "components": (0.25, 0.5, 0.75, 1.5, 2.0),
}
USUAL_IMAGE_SIZE_MM: Final = 3.0

_SLOW_SEEDS: Final = 2  # for methods that are not a single matrix: a frame takes them a thousand times as long

_DIGITS: Final = 4096
_CHOOSING: Final = frozenset({"noise_figure", "choose"})

Prepare = Callable[[ImagingProblem], PreparedReconstruction]


@dataclass(frozen=True, slots=True)
class MethodSetting:
    """A registered reconstruction, its options that are not default, and the option that gives λ (empty if none)."""

    name: str
    options: tuple[tuple[str, Knob], ...] = ()
    smoothing: str = ""

    def knobs(self, **more: float) -> dict[str, Knob]:
        """Its name, its options, and what else is set."""
        return {"method": self.name, **dict(self.options), **more}


#: Method of the shipped recipes.
RECIPES_METHOD: Final = MethodSetting(
    "gauss-newton-noser", (("noise_figure", 1.0), ("exponent", 0.25)), "hyperparameter"
)


def list_methods() -> Iterator[MethodSetting]:
    """Registered reconstructions that image single frames as differences, with their option for λ.

    Those that need neighbouring frames or a sensor's own readings, or are not installed, are left out. λ is varied
    only if ``prepare`` declares to return one matrix: images of others take too long.
    """
    plugins = discover()
    for name in plugins.names(Kind.RECONSTRUCTION):
        factory = plugins.factory(Kind.RECONSTRUCTION, name)
        if getattr(factory, "sequences", False) or getattr(factory, "absolute", False):
            continue
        try:
            factory()
        except CbsrError:
            continue
        one_matrix = get_type_hints(getattr(factory, "prepare", object)).get("return") is LinearReconstruction
        known_options = options_of(factory).model_fields if one_matrix else {}
        yield MethodSetting(name, (), next((option for option in FACTORS if option in known_options), ""))


def measure_method(method: MethodSetting, factor: float, seeds: int) -> Point:
    """Measure one method with one λ on the base scene's nine loads; a refusal is a point with the reason as its note.

    ``compute_s`` is the image of one frame, ``setup_s`` preparing the method for an existing problem.

    Parameters
    ----------
    factor : λ, or the number of components, relative to the method's own choice.
    seeds : simulated sensors; methods that are not one matrix get two.
    """
    knobs = method.knobs(smoothing_over_own=factor)
    return _measure_method(SERIES_METHODS, knobs, _problem(seeds=seeds), partial(_prepare, method, factor), seeds)


def measure_mesh(method: MethodSetting, image_size_mm: float, seeds: int) -> Point:
    """Measure one density of the image's mesh; ``setup_s`` is mesh, Jacobian, and the method with its own λ."""
    problem = _problem(image_size_mm, seeds)
    _, jacobian_s = time_call(partial(_linearise, base_scene_readings(seeds).sensor_type, image_size_mm))
    series, knobs = f"{SERIES_MESHES}, {method.name}", method.knobs(image_size_mm=image_size_mm)
    return _measure_method(series, knobs, problem, partial(_prepare, method, 1.0), seeds, jacobian_s)


def _measure_method(
    series: str,
    knobs: Mapping[str, Knob],
    problem: ImagingProblem,
    method: Callable[[], Prepare],
    seeds: int,
    problem_s: float = 0.0,
) -> Point:
    """Measure a method on a problem; the time to set that up counts only if given [s]."""
    costs = {"unknowns": float(len(problem.mesh.elements))}
    try:
        prepared, setup_s = time_call(partial(method(), _unseen(problem, knobs)))
        matrix = prepared.matrix if isinstance(prepared, LinearReconstruction) else None
        seeds = min(seeds, _SLOW_SEEDS) if matrix is None else seeds
        readings = base_scene_readings(seeds)
        accuracy = figures_of_merit(prepared, readings)
    except CbsrError as refusal:
        costs |= {"setup_s": problem_s} if problem_s else {}
        return Point(TimeBasis.COMPUTER, series, knobs, {}, seeds=seeds, note=refusal.reason, costs=costs)
    frame, choice = sensor_changes(readings, 0, prepared)[1][:1], prepared.choice
    note = f"{choice.name} {choice.value:.3g}, noise figure {choice.noise_figure:.2f}"
    costs["setup_s"] = setup_s + problem_s
    if matrix is not None:
        costs["memory_bytes"] = float(matrix.nbytes)
    frame_s = fastest_s(lambda: prepared.images(frame), 1 if matrix is None else REPEATS)
    return Point(TimeBasis.COMPUTER, series, knobs, accuracy, frame_s, seeds=seeds, note=note, costs=costs)


def _unseen(problem: ImagingProblem, knobs: Mapping[str, Knob]) -> ImagingProblem:
    """The same problem except for the last digits of a reading, so that methods reuse no cache of another setting.

    The digits follow from the setting alone, so that results are the same in every process.
    """
    reference = problem.reference.copy()
    reference[0] *= 1 + (1 + crc32(repr(knobs).encode()) % _DIGITS) * np.finfo(np.float64).eps
    return replace(problem, reference=reference)


def _linearise(sensor_type: SensorType, image_size_mm: float) -> None:
    """Compute a problem again: the image's mesh, and its Jacobian for one reading of each reciprocal pair."""
    group, _ = sensor_type.pattern.reading_groups()
    drive, measure = np.unravel_index(np.unique(group, return_index=True)[1], group.shape)
    mesh = image_mesh(sensor_type, size_mm=image_size_mm)
    image_jacobian(nominal_model(sensor_type), mesh, drive, measure)


def make_method(method: MethodSetting, **instead: float) -> Reconstruction:
    """The method with its options; a given option replaces those by which λ is chosen."""
    options = {name: value for name, value in method.options if not (instead and name in _CHOOSING)}
    method_instance: Reconstruction = discover().factory(Kind.RECONSTRUCTION, method.name)(**options, **instead)
    return method_instance


def _problem(image_size_mm: float = USUAL_IMAGE_SIZE_MM, seeds: int = 1) -> ImagingProblem:
    return imaging_problem(base_scene_readings(seeds).sensor_type, image_size_mm=image_size_mm)


def _prepare(method: MethodSetting, factor: float) -> Prepare:
    """What prepares the method with its own λ, or a multiple of it."""
    return (
        make_method(method).prepare
        if factor == 1.0
        else partial(_prepare_smoothed, method, _choose_nominal(method) * factor)
    )


@cache
def _choose_nominal(method: MethodSetting) -> float:
    """λ, or its equivalent, chosen by a method on the sensor type's nominal problem."""
    return make_method(method).prepare(_problem()).choice.value


def _prepare_smoothed(method: MethodSetting, value: float, problem: ImagingProblem) -> PreparedReconstruction:
    """The method with a given λ, or number of components."""
    if method.smoothing != "components":
        return make_method(method, **{method.smoothing: value}).prepare(problem)
    component_count = max(1, round(value))
    try:
        return make_method(method, components=component_count).prepare(problem)
    except NumericsError:  # a pair of components: an adjacent count splits no pair
        return make_method(method, components=component_count + 1).prepare(problem)


def measure_precision(precision: str, batch: int) -> Point:
    """Measure the matrix of the shipped recipes on blocks of simulated changes, in float32 or float64.

    ``compute_s`` is the time of one frame of a block, rounding of the readings included. The error is the largest
    ‖x − x₀‖/‖x₀‖ of nine loads' images, with x₀ computed in the longest floating-point numbers of the machine.
    """
    matrix, changes = _recipes_matrix()
    block = np.resize(changes, (batch, changes.shape[1]))
    apply = make_imager(matrix, precision)
    exact = changes.astype(np.longdouble) @ matrix.astype(np.longdouble).T
    batches = [changes[first : first + batch] for first in range(0, len(changes), batch)]
    images = [apply(np.resize(part, (batch, changes.shape[1])))[: len(part)] for part in batches]
    size = np.dtype(precision).itemsize
    return Point(
        TimeBasis.COMPUTER,
        SERIES_PRECISION,
        {"precision": precision, "batch": batch},
        {"image_error": Accuracy(relative_error(np.concatenate(images), exact), None, "1")},
        fastest_s(lambda: apply(block)) / batch,
        note=f"{matrix.shape[1]} readings to {matrix.shape[0]} elements",
        costs={
            "unknowns": float(matrix.shape[0]),
            "memory_bytes": float(size * (matrix.size + batch * sum(matrix.shape))),
        },
    )


def make_imager(matrix: Array, precision: str) -> Callable[[Array], Floats]:
    """Return what images blocks of changes (n, m) in a precision: (n, e)."""
    transposed = np.ascontiguousarray(matrix.T, dtype=precision)

    def apply(block: Array) -> Floats:
        images: Floats = block.astype(precision, copy=False) @ transposed
        return images

    return apply


def relative_error(images: Floats, exact: Floats) -> float:
    """Largest ‖x − x₀‖/‖x₀‖ of images (n, e)."""
    error_norm, size = (np.sqrt((part**2).sum(axis=1)) for part in (images - exact, exact))
    return float((error_norm / size).max())


@cache
def _recipes_matrix() -> tuple[Array, Array]:
    """Matrix (e, m) of the shipped recipes, and changes of a simulated sensor for the nine loads (9, m)."""
    prepared = linear(make_method(RECIPES_METHOD).prepare(_problem()))
    return prepared.matrix, sensor_changes(base_scene_readings(1), 0, prepared)[1]
