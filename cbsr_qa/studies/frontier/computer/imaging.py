"""Images: effect of methods, smoothing and mesh density on the places of loads, and their cost in time.

For imaging matrices: digits lost and time saved by single precision and large blocks of frames.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Final, get_type_hints
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain import Array, CbsrError, NumericsError
from cbsr_qa.domain.results import ImagingProblem, LinearReconstruction, PreparedReconstruction, linear
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.eit.inverse import image_jacobian, imaging_problem, nominal_model
from cbsr_qa.eit.mesh import image_mesh
from cbsr_qa.plugin import Kind, Reconstruction, discover, options_of
from cbsr_qa.studies.frontier.computer.forward import fastest_s, timed
from cbsr_qa.studies.frontier.computer.readings import base_scene_readings, figures_of_merit, sensor_changes
from cbsr_qa.studies.frontier.point import Accuracy, Knob, Point, TimeBasis

Floats = NDArray[np.floating[Any]]

SERIES: Final = "applying the matrix"
PRECISIONS: Final = ("float32", "float64")
BATCHES: Final = (1, 16, 256, 4096)
SERIES_METHODS: Final = "reconstruction"
SERIES_MESHES: Final = "image mesh"  # and the method's name

#: λ relative to a method's own choice; for a count of components likewise.
FACTORS: Final[Mapping[str, tuple[float, ...]]] = {
    "hyperparameter": (0.03, 0.1, 0.3, 3.0, 10.0, 30.0),
    "components": (0.25, 0.5, 0.75, 1.5, 2.0),
}
IMAGE_SIZES_MM: Final = (8.0, 6.0, 5.0, 4.0, 3.0, 2.5, 2.0)
USUAL_IMAGE_SIZE_MM: Final = 3.0

_SLOW_SEEDS: Final = 2  # for methods that are not a single matrix: a frame takes them a thousand times as long

_DIGITS: Final = 4096
_CHOOSING: Final = frozenset({"noise_figure", "choose"})

Options = tuple[tuple[str, Knob], ...]
Prepare = Callable[[ImagingProblem], PreparedReconstruction]


@dataclass(frozen=True, slots=True)
class MethodSetting:
    """A registered reconstruction, its options that are not default, and the option that gives λ (empty if none)."""

    name: str
    options: Options = ()
    smoothing: str = ""


#: Method of the shipped recipes.
RECIPES_METHOD: Final = MethodSetting(
    "gauss-newton-noser", (("noise_figure", 1.0), ("exponent", 0.25)), "hyperparameter"
)


def registered_methods() -> Iterator[MethodSetting]:
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
        yield MethodSetting(name, (), _smoothing_of(factory))


def _smoothing_of(factory: Callable[..., Any]) -> str:
    if get_type_hints(getattr(factory, "prepare", None) or object).get("return") is not LinearReconstruction:
        return ""
    known = options_of(factory).model_fields
    return next((option for option in FACTORS if option in known), "")


def method_point(method: MethodSetting, factor: float, seeds: int) -> Point:
    """Measure one method with one λ on the base scene's nine loads; a refusal is a point with the reason as its note.

    ``compute_s`` is the image of one frame, ``setup_s`` preparing the method for an existing problem.

    Parameters
    ----------
    factor : λ, or the number of components, relative to the method's own choice.
    seeds : simulated sensors; methods that are not one matrix get two.
    """
    knobs: dict[str, Knob] = {"method": method.name, **dict(method.options), "smoothing_over_own": factor}
    problem = imaging_problem(base_scene_readings(seeds).sensor_type, image_size_mm=USUAL_IMAGE_SIZE_MM)

    def ready() -> Prepare:
        if factor == 1.0:
            return made(method).prepare
        return partial(_smoothed, method, _own_choice(method) * factor)

    return _imaged(SERIES_METHODS, knobs, problem, ready, seeds, {})


def mesh_point(method: MethodSetting, image_size_mm: float, seeds: int) -> Point:
    """Measure one density of the image's mesh; ``setup_s`` is mesh, Jacobian, and the method with its own λ."""
    readings = base_scene_readings(seeds)
    knobs: dict[str, Knob] = {"method": method.name, **dict(method.options), "image_size_mm": image_size_mm}
    problem = imaging_problem(readings.sensor_type, image_size_mm=image_size_mm)
    _, jacobian_s = timed(partial(_linearise, readings.sensor_type, image_size_mm))
    series = f"{SERIES_MESHES}, {method.name}"
    return _imaged(series, knobs, problem, lambda: made(method).prepare, seeds, {"setup_s": jacobian_s})


def _imaged(
    series: str,
    knobs: Mapping[str, Knob],
    problem: ImagingProblem,
    ready: Callable[[], Prepare],
    seeds: int,
    costs: Mapping[str, float],
) -> Point:
    unknowns = {"unknowns": float(len(problem.mesh.elements))}
    try:
        prepared, setup_s = timed(partial(ready(), _unseen(problem, knobs)))
        seeds = seeds if isinstance(prepared, LinearReconstruction) else min(seeds, _SLOW_SEEDS)
        readings = base_scene_readings(seeds)
        accuracy = figures_of_merit(prepared, readings)
    except CbsrError as refusal:
        return Point(TimeBasis.COMPUTER, series, knobs, {}, None, None, seeds, refusal.reason, {**unknowns, **costs})
    frame, choice = sensor_changes(readings, 0, prepared)[1][:1], prepared.choice
    note = f"{choice.name} {choice.value:.3g}, noise figure {choice.noise_figure:.2f}"
    costs = {**unknowns, **costs, "setup_s": setup_s + costs.get("setup_s", 0.0)}
    if isinstance(prepared, LinearReconstruction):
        costs["memory_bytes"] = float(prepared.matrix.nbytes)
    frame_s = fastest_s(lambda: prepared.images(frame), _repeats(prepared))
    return Point(TimeBasis.COMPUTER, series, knobs, accuracy, frame_s, None, seeds, note, costs)


def _unseen(problem: ImagingProblem, knobs: Mapping[str, Knob]) -> ImagingProblem:
    """The same problem except for the last digits of a reading, so that methods reuse no cache of another setting.

    The digits follow from the setting alone, so that results are the same in every process.
    """
    reference = problem.reference.copy()
    reference[0] *= 1 + (1 + crc32(repr(knobs).encode()) % _DIGITS) * np.finfo(np.float64).eps
    return replace(problem, reference=reference)


def _repeats(prepared: PreparedReconstruction) -> int:
    return 7 if isinstance(prepared, LinearReconstruction) else 1


def _linearise(sensor_type: SensorType, image_size_mm: float) -> None:
    """Compute a problem again: the image's mesh, and its Jacobian for one reading of each reciprocal pair."""
    group, _ = sensor_type.pattern.reading_groups()
    drive, measure = np.unravel_index(np.unique(group, return_index=True)[1], group.shape)
    mesh = image_mesh(sensor_type, size_mm=image_size_mm)
    image_jacobian(nominal_model(sensor_type), mesh, drive, measure)


def made(method: MethodSetting, **instead: float) -> Reconstruction:
    """The method with its options; a given option replaces those by which λ is chosen."""
    options = {name: value for name, value in method.options if not (instead and name in _CHOOSING)}
    made: Reconstruction = discover().factory(Kind.RECONSTRUCTION, method.name)(**options, **instead)
    return made


@lru_cache(maxsize=64)
def _own_choice(method: MethodSetting) -> float:
    """λ, or its equivalent, chosen by a method on the sensor type's nominal problem."""
    problem = imaging_problem(base_scene_readings(1).sensor_type, image_size_mm=USUAL_IMAGE_SIZE_MM)
    return made(method).prepare(problem).choice.value


def _smoothed(method: MethodSetting, value: float, problem: ImagingProblem) -> PreparedReconstruction:
    """The method with a given λ, or number of components."""
    if method.smoothing != "components":
        return made(method, **{method.smoothing: value}).prepare(problem)
    whole = max(1, round(value))
    try:
        return made(method, components=whole).prepare(problem)
    except NumericsError:  # a pair of components: an adjacent count splits no pair
        return made(method, components=whole + 1).prepare(problem)


def precision_point(precision: str, batch: int) -> Point:
    """Measure the matrix of the shipped recipes on blocks of simulated changes, in float32 or float64.

    ``compute_s`` is the time of one frame of a block, rounding of the readings included. The error is the largest
    ‖x − x₀‖/‖x₀‖ of nine loads' images, with x₀ computed in the longest floating-point numbers of the machine.
    """
    matrix, changes = _matrix(), _changes()
    block = np.resize(changes, (batch, changes.shape[1]))
    apply = applied(matrix, precision)
    exact = changes.astype(np.longdouble) @ matrix.astype(np.longdouble).T
    parts = [changes[first : first + batch] for first in range(0, len(changes), batch)]
    images = [apply(np.resize(part, (batch, changes.shape[1])))[: len(part)] for part in parts]
    size = np.dtype(precision).itemsize
    return Point(
        TimeBasis.COMPUTER,
        SERIES,
        {"precision": precision, "batch": batch},
        {"image_error": Accuracy(relative_error(np.concatenate(images), exact), None, "1")},
        fastest_s(lambda: apply(block)) / batch,
        None,
        1,
        f"{matrix.shape[1]} readings to {matrix.shape[0]} elements",
        {
            "unknowns": float(matrix.shape[0]),
            "memory_bytes": float(size * (matrix.size + batch * sum(matrix.shape))),
        },
    )


def applied(matrix: Array, precision: str) -> Callable[[Array], Floats]:
    """Return what images blocks of changes (n, m) in a precision: (n, e)."""
    kept = np.ascontiguousarray(matrix.T, dtype=precision)

    def apply(block: Array) -> Floats:
        images: Floats = block.astype(precision, copy=False) @ kept
        return images

    return apply


def relative_error(images: Floats, exact: Floats) -> float:
    """Largest ‖x − x₀‖/‖x₀‖ of images (n, e)."""
    apart, size = (np.sqrt((part**2).sum(axis=1)) for part in (images - exact, exact))
    return float((apart / size).max())


@lru_cache(maxsize=1)
def _matrix() -> Array:
    problem = imaging_problem(base_scene_readings(1).sensor_type, image_size_mm=USUAL_IMAGE_SIZE_MM)
    return linear(made(RECIPES_METHOD).prepare(problem)).matrix


@lru_cache(maxsize=1)
def _changes() -> Array:
    """Changes of a simulated sensor for the nine loads, (9, m)."""
    readings = base_scene_readings(1)
    problem = imaging_problem(readings.sensor_type, image_size_mm=USUAL_IMAGE_SIZE_MM)
    return sensor_changes(readings, 0, made(RECIPES_METHOD).prepare(problem))[1]
