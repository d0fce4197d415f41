"""Sweeps of computing time: work that can be measured in any order and any process."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
import scipy

import cbsr_qa
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.studies.frontier.computer.forward import SERIES_FORWARD, measure_forward
from cbsr_qa.studies.frontier.computer.imaging import (
    FACTORS,
    RECIPES_METHOD,
    SERIES_MESHES,
    SERIES_METHODS,
    SERIES_PRECISION,
    MethodSetting,
    list_methods,
    measure_mesh,
    measure_method,
    measure_precision,
)
from cbsr_qa.studies.frontier.point import Knob, Point
from cbsr_qa.studies.frontier.worth import mark_worth
from cbsr_qa.studies.sweep import Work

# Settings of the whole sweep (False) and of the quick one (True).
_SEEDS: Final = {False: 8, True: 3}
#: Sizes of elements [mm] by electrodes and order, coarse to fine.
_SIZES_MM: Final[Mapping[bool, Mapping[tuple[str, int], tuple[float, ...]]]] = {
    False: {
        ("arc", 1): (6.0, 4.0, 3.0, 2.0, 1.4),
        ("arc", 2): (10.0, 7.5, 6.0, 5.0, 4.0),
        ("pin", 1): (6.0, 4.0, 3.0, 2.25, 1.6),
        ("pin", 2): (12.0, 8.0, 6.0, 5.0, 3.5),
    },
    True: {("arc", 1): (3.0,), ("arc", 2): (10.0, 7.5), ("pin", 1): (3.0,), ("pin", 2): (12.0, 8.0)},
}
_BATCHES: Final = {False: (1, 16, 256, 4096), True: (1, 256)}
_LAPLACE: Final = MethodSetting("gauss-newton-laplace", (), "hyperparameter")
_GREIT: Final = MethodSetting("greit", (), "hyperparameter")
_QUICK_METHODS: Final = ((RECIPES_METHOD, 0.3), (RECIPES_METHOD, 1.0), (RECIPES_METHOD, 3.0), (_LAPLACE, 1.0))
#: Sizes of the image's elements by method, coarse to fine; GREIT's training takes seconds on finer meshes.
_IMAGE_SIZES_MM: Final[Mapping[bool, Mapping[MethodSetting, tuple[float, ...]]]] = {
    False: {RECIPES_METHOD: (8.0, 6.0, 5.0, 4.0, 3.0, 2.5, 2.0), _GREIT: (8.0, 6.0, 5.0, 4.0, 3.0)},
    True: {RECIPES_METHOD: (6.0, 3.0), _GREIT: (6.0,)},
}

_VERSION: Final = 2  # of the measured quantity: points of different versions are not comparable


def plan_computer_work(*, quick: bool = False) -> Iterator[Work]:
    """Yield measurements of computing time, whose result is one point each; for the quick sweep a few of a series."""
    for (electrodes, order), sizes_mm in _SIZES_MM[quick].items():
        for size_mm in sizes_mm:
            knobs: dict[str, Knob] = {"element_order": order, "element_size_mm": size_mm}
            yield _work(SERIES_FORWARD[electrodes], knobs, partial(measure_forward, electrodes, order, size_mm))
    for precision in ("float32", "float64"):
        for batch in _BATCHES[quick]:
            run = partial(measure_precision, precision, batch)
            yield _work(SERIES_PRECISION, {"precision": precision, "batch": batch}, run)
    seeds = _SEEDS[quick]
    all_methods = (
        (method, factor)
        for method in (*list_methods(), RECIPES_METHOD)
        for factor in sorted((1.0, *FACTORS.get(method.smoothing, ())))
    )
    for method, factor in _QUICK_METHODS if quick else all_methods:
        run = partial(measure_method, method, factor, seeds)
        yield _method_work(SERIES_METHODS, method, run, seeds, smoothing_over_own=factor)
    for method, sizes_mm in _IMAGE_SIZES_MM[quick].items():
        for size_mm in sizes_mm:
            run = partial(measure_mesh, method, size_mm, seeds)
            yield _method_work(f"{SERIES_MESHES}, {method.name}", method, run, seeds, image_size_mm=size_mm)


def mark_worth_of_computer(points: Sequence[Point]) -> list[Point]:
    """Mark which points are undominated within errors among those of their series.

    Settings with one matrix of the same size do the same arithmetic: measured differences are chance, and each gets
    the lowest cost. A refused setting is never worth its time.
    """
    measured_points = [point for point in points if point.compute_s is not None and point.accuracy]
    least_cost_s: dict[float, float] = {}
    for point in measured_points:
        size = _matrix_bytes(point)
        least_cost_s[size] = min(least_cost_s.get(size, np.inf), point.compute_s or 0.0)

    def common_cost_s(point: Point) -> float | None:
        shared = least_cost_s.get(_matrix_bytes(point)) if _matrix_bytes(point) else point.compute_s
        return shared if point.accuracy else None

    return mark_worth(points, common_cost_s)


def _method_work(series: str, method: MethodSetting, run: Callable[[], Point], seeds: int, **knob: float) -> Work:
    registered = (plugin for plugin in discover().registrations(Kind.RECONSTRUCTION) if plugin.name == method.name)
    distribution = next((f"{plugin.distribution} {plugin.version}" for plugin in registered), "")
    return _work(series, method.knobs(**knob), run, seeds=seeds, plugin=distribution)


def _work(series: str, knobs: Mapping[str, Knob], run: Callable[[], Point], **more: Any) -> Work:
    setting = ", ".join(f"{name}={value}" for name, value in knobs.items())
    versions = {"cbsr-qa": cbsr_qa.__version__, "numpy": np.__version__, "scipy": scipy.__version__}
    version_words = ", ".join(f"{name}={value}" for name, value in {"sweep": _VERSION, **versions, **more}.items())
    return Work(f"computer; {series}; {setting}; {version_words}", f"{series}: {setting}", partial(_measure, run))


def _measure(run: Callable[[], Point]) -> list[Point]:
    return [run()]


def _matrix_bytes(point: Point) -> float:
    """Size of the single matrix of an image; 0 otherwise."""
    return point.costs.get("memory_bytes", 0.0) if point.series == SERIES_METHODS else 0.0
