"""Sweeps of computing time: tasks that can be measured in any order and any process."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np
import scipy

import cbsr_qa
from cbsr_qa.plugin import Kind, discover
from cbsr_qa.studies.frontier.computer.forward import SERIES_ARCS, SERIES_PINS, SIZES_MM, forward_point
from cbsr_qa.studies.frontier.computer.imaging import (
    BATCHES,
    FACTORS,
    IMAGE_SIZES_MM,
    PRECISIONS,
    RECIPES_METHOD,
    SERIES as SERIES_PRECISION,
    SERIES_MESHES,
    SERIES_METHODS,
    MethodSetting,
    mesh_point,
    method_point,
    precision_point,
    registered_methods,
)
from cbsr_qa.studies.frontier.point import Knob, Point, Task
from cbsr_qa.studies.frontier.recommend import undominated_within_errors

SEEDS: Final = 8
QUICK_SEEDS: Final = 3

_VERSION: Final = 1  # of the measured quantity: points of different versions are not comparable
_QUICK_SIZES_MM: Final[Mapping[str, Mapping[int, tuple[float, ...]]]] = {
    "arc": {1: (3.0,), 2: (10.0, 7.5)},
    "pin": {1: (3.0,), 2: (12.0, 8.0)},
}
_LAPLACE: Final = MethodSetting("gauss-newton-laplace", (), "hyperparameter")
_GREIT: Final = MethodSetting("greit", (), "hyperparameter")
#: Settings of image and mesh in the quick sweep.
_QUICK_METHODS: Final = ((RECIPES_METHOD, 0.3), (RECIPES_METHOD, 1.0), (RECIPES_METHOD, 3.0), (_LAPLACE, 1.0))
_QUICK_MESHES: Final = ((RECIPES_METHOD, 6.0), (RECIPES_METHOD, 3.0), (_GREIT, 6.0))
_GREIT_SIZES_MM: Final = (8.0, 6.0, 5.0, 4.0, 3.0)  # its training takes seconds on finer meshes
_QUICK_BATCHES: Final = (1, 256)


def computer_tasks(*, quick: bool = False) -> list[Task]:
    """Return the tasks of computing time; for the quick sweep a few of each series."""
    return [
        *_forward(_QUICK_SIZES_MM if quick else SIZES_MM),
        *_precision(_QUICK_BATCHES if quick else BATCHES),
        *_methods(quick),
        *_meshes(quick),
    ]


def worth_their_time(points: Sequence[Point]) -> tuple[bool, ...]:
    """Return for every point whether it is undominated within errors among those of its series.

    Settings with one matrix of the same size do the same arithmetic: measured differences are chance, and each gets
    the lowest cost. A refused setting is never worth its time.
    """
    costs = _shared_costs(points)
    flags = [False] * len(points)
    for series in {point.series for point in points}:
        members = [at for at, point in enumerate(points) if point.series == series and at in costs]
        priced = [replace(points[at], compute_s=costs[at]) for at in members]
        kept = undominated_within_errors(priced, lambda point: point.compute_s)
        for at, on in zip(members, kept, strict=True):
            flags[at] = on
    return tuple(flags)


def _forward(sizes_mm: Mapping[str, Mapping[int, tuple[float, ...]]]) -> Iterator[Task]:
    for electrodes, by_order in sizes_mm.items():
        series = SERIES_ARCS if electrodes == "arc" else SERIES_PINS
        for order, sizes in by_order.items():
            for size in sizes:
                knobs: dict[str, Knob] = {"element_order": order, "element_size_mm": size}
                yield _task(series, knobs, partial(forward_point, electrodes, order, size))


def _precision(batches: Sequence[int]) -> Iterator[Task]:
    for precision in PRECISIONS:
        for batch in batches:
            run = partial(precision_point, precision, batch)
            yield _task(SERIES_PRECISION, {"precision": precision, "batch": batch}, run)


def _methods(quick: bool) -> Iterator[Task]:
    seeds = QUICK_SEEDS if quick else SEEDS
    settings = list(_QUICK_METHODS) if quick else []
    for method in () if quick else (*registered_methods(), RECIPES_METHOD):
        settings += [(method, factor) for factor in sorted((1.0, *FACTORS.get(method.smoothing, ())))]
    for method, factor in settings:
        knobs = {"method": method.name, **dict(method.options), "smoothing_over_own": factor}
        run = partial(method_point, method, factor, seeds)
        yield _task(SERIES_METHODS, knobs, run, seeds=seeds, plugin=_distribution(method))


def _meshes(quick: bool) -> Iterator[Task]:
    every = [(RECIPES_METHOD, size) for size in IMAGE_SIZES_MM] + [(_GREIT, size) for size in _GREIT_SIZES_MM]
    seeds = QUICK_SEEDS if quick else SEEDS
    for method, size in _QUICK_MESHES if quick else every:
        knobs = {"method": method.name, **dict(method.options), "image_size_mm": size}
        run = partial(mesh_point, method, size, seeds)
        yield _task(f"{SERIES_MESHES}, {method.name}", knobs, run, seeds=seeds, plugin=_distribution(method))


def _task(series: str, knobs: Mapping[str, Knob], run: Callable[[], Point], **more: Any) -> Task:
    setting = ", ".join(f"{name}={value}" for name, value in knobs.items())
    versions = {"cbsr-qa": cbsr_qa.__version__, "numpy": np.__version__, "scipy": scipy.__version__}
    known = ", ".join(f"{name}={value}" for name, value in {"sweep": _VERSION, **versions, **more}.items())
    return Task(f"computer; {series}; {setting}; {known}", f"{series}: {setting}", run)


def _distribution(method: MethodSetting) -> str:
    registered = (plugin for plugin in discover().registrations(Kind.RECONSTRUCTION) if plugin.name == method.name)
    return next((f"{plugin.distribution} {plugin.version}" for plugin in registered), "")


def _shared_costs(points: Sequence[Point]) -> dict[int, float]:
    """Time of every point that has one, by index [s]."""
    costs, least = {}, dict[tuple[str, float], float]()
    for at, point in enumerate(points):
        if point.compute_s is not None and point.accuracy:
            costs[at] = point.compute_s
            if size := _matrix_bytes(point):
                key = (point.series, size)
                least[key] = min(least.get(key, point.compute_s), point.compute_s)
    return {at: least.get((points[at].series, _matrix_bytes(points[at])), cost) for at, cost in costs.items()}


def _matrix_bytes(point: Point) -> float:
    """Size of the single matrix of an image; 0 otherwise."""
    return point.costs.get("memory_bytes", 0.0) if point.series == SERIES_METHODS else 0.0
