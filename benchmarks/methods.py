"""Every registered reconstruction on the same loads: what it costs and where it puts them."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from benchmarks.localisation import TRIED
from benchmarks.nine_sites import Loads, Score, disc, loads, score
from benchmarks.rows import Row
from benchmarks.timing import fastest, shown
from cbsr_qa.domain.imaging import ImagingProblem, LinearReconstruction
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import Reconstruction

Array = NDArray[np.float64]

TITLE = "Reconstructions"
_FRAMES = 4


def rows() -> Iterator[Row]:
    """Nine sites, γ +50 %, 60 dB a channel, by every method with its own choice of parameters."""
    plugins = discover()
    truth = loads()
    problem = imaging_problem(disc())  # the sensor type's own model is prepared once for all methods
    problem = replace(problem, measured=truth.reference[problem.used])
    changes = truth.noisy(problem, 60.0, _FRAMES)
    for name in plugins.names(Kind.RECONSTRUCTION):
        if name.startswith("pyeit") and find_spec("pyeit") is None:
            continue
        factory = plugins.factory(Kind.RECONSTRUCTION, name)
        if name.startswith("pyeit"):
            tried = [_row(partial(factory, **options), problem, changes, truth) for options in TRIED[name]]
            _, here = min(tried, key=lambda one: one[0].error_mm)
        else:
            _, here = _row(factory, problem, changes, truth)
        elements, how = len(problem.mesh.elements), " tuned on these loads" if name.startswith("pyeit") else ""
        yield Row(f"{name}{how}, nine sites, γ +50 %, 60 dB a channel, {elements} elements", "", here)


def _row(
    factory: Callable[[], Reconstruction], problem: ImagingProblem, changes: Array, truth: Loads
) -> tuple[Score, str]:
    began = time.perf_counter()
    prepared = factory().prepare(problem)
    setup = time.perf_counter() - began
    block = changes.reshape(-1, changes.shape[2])
    took = fastest(partial(prepared.images, block), 20 if isinstance(prepared, LinearReconstruction) else 1)
    alone = [[prepared.images(frame[None])[0] for frame in frames] for frames in changes]
    figures = score(alone, problem.mesh, truth.places)
    return figures, (
        f"set-up {shown(setup)}, {shown(took / len(block))} a frame; {figures.words()};"
        f" noise figure {prepared.choice.noise_figure:.2f}"
    )


def notes() -> str:
    return (
        "\nImages are of single frames; the time of a frame is that in a block of 36. Only pyEIT's methods are"
        " tuned on these loads; the others use their defaults, chosen on the nominal model. Masks are at 85 %,"
        " with regions bounded by a contour. The truth is computed on another mesh with other contacts.\n"
    )
