"""Linear reconstructions: setting them up, choosing λ, and imaging."""

import contextlib
import io
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from benchmarks.nine_sites import disc, loads, score
from benchmarks.peers import peer
from benchmarks.rows import Row
from benchmarks.timing import compare, fastest, shown
from cbsr_qa.domain.imaging import LinearReconstruction
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.eit.forward.model import point_model
from cbsr_qa.eit.inverse.dual import dual_matrix, dual_spectrum
from cbsr_qa.eit.inverse.noise_figures import hyperparameter_for
from cbsr_qa.eit.inverse.pixels import pixel_imaging
from cbsr_qa.eit.inverse.priors import noser
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.inverse.regularisation import Criterion
from cbsr_qa.eit.mesh.pyeit import import_pyeit_mesh
from cbsr_qa_plugins.reconstruction.one_step import GaussNewtonLaplace

TITLE = "Linear reconstructions"

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_REPEATS = 20
_LAMBDA = 0.03
_PATTERN = adjacent_pattern(16)


def rows() -> Iterator[Row]:
    """Set-up, choice of λ and imaging, on pyEIT's own mesh where it is compared with."""
    yield _set_up()
    yield _noise_figure()
    yield from _imaging()
    yield from _criteria()


def notes() -> str:
    return (
        "\nSet-up is everything from a mesh in memory on: assembly, factorisation, fields, Jacobian, NOSER"
        " prior and imaging matrix of all 208 readings. Reciprocal readings have equal rows, so the matrix is"
        " solved for 104 of them. Our pixels are in single precision, which is as exact as readings of 24"
        " bits, and only pixels of the sheet and the 104 merged readings are multiplied. pyEIT multiplies all"
        " pixels and readings in double precision, which causes most of the difference. Its set-up takes half"
        " a minute and is timed once. Criteria that depend on readings use the 36 frames of the nine sites,"
        " with the noise of each channel.\n"
    )


@lru_cache(maxsize=1)
def _mesh() -> tuple[Mesh, Indices]:
    """The finest disc of pyEIT, and the nodes of its electrodes."""
    sheet = import_pyeit_mesh(peer().mesh)
    return sheet.mesh, sheet.electrode_nodes


def _distinct() -> tuple[Indices, Indices, Indices]:
    """Drive and measure pair of one reading of each reciprocal pair, and which of them every used reading is."""
    used = _PATTERN.usable()
    names = _PATTERN.reading_groups()[0][used]
    _, first, group = np.unique(names, return_index=True, return_inverse=True)
    drive, measure = np.argwhere(used)[first].T
    return drive, measure, group.astype(np.int64)


def _jacobian() -> Array:
    mesh, electrodes = _mesh()
    fresh = Mesh(mesh.nodes_mm, mesh.elements)  # what it works out of itself is part of the set-up
    model = point_model(fresh, electrodes, _PATTERN, np.ones(len(mesh.elements)))
    return model.jacobian_rows(*_distinct()[:2])


def _matrix() -> Array:
    jacobian, group = _jacobian(), _distinct()[2]
    folded = dual_matrix(jacobian, noser(jacobian, 0.5), _LAMBDA, np.full(len(jacobian), 0.5))
    return 0.5 * folded[:, group]


def _set_up() -> Row:
    ours = fastest(_matrix, _REPEATS)
    with contextlib.redirect_stdout(io.StringIO()):
        theirs = fastest(peer().jac, 1)
    ratio = theirs / ours
    return Row(
        f"Jacobian and reconstruction matrix, {len(_mesh()[0].elements)} elements",
        "≥ 140 × faster",
        f"{shown(ours)}, {ratio:.0f} × faster",
        f"pyEIT JAC: {shown(theirs)}",
        ratio >= 140,
    )


def _noise_figure() -> Row:
    mesh = _mesh()[0]

    def chosen() -> float:
        jacobian = _jacobian()
        prior, variance = noser(jacobian, 0.5), np.full(len(jacobian), 0.5)
        target = jacobian @ (0.01 * (np.hypot(*mesh.centroids_mm.T) < 0.13))
        spectrum = dual_spectrum(jacobian, prior, variance)
        return hyperparameter_for(1.0, spectrum, target, mesh.areas_mm2, variance)

    took = fastest(chosen, _REPEATS)
    return Row(
        f"λ of noise figure 1, {len(mesh.elements)} elements, Jacobian and prior included",
        "< 1 s",
        f"{shown(took)}, to ten digits",
        "EIDORS: 6 to 70 s (stated with the goal, not measured here); pyEIT has no such choice",
        took < 1,
    )


def _imaging() -> Iterator[Row]:
    linear = GaussNewtonLaplace().prepare(imaging_problem(disc()))
    raster = pixel_imaging(linear, 32)
    frames = 1e-3 * np.random.default_rng(0).standard_normal((1000, len(linear.problem.reference)))
    theirs = peer().greit()
    before = peer().readings()
    after = before * (1 + 1e-3 * np.random.default_rng(0).standard_normal(before.shape))
    one = compare(
        "one frame to 1024 pixels",
        ("ours", lambda: raster.image(frames[0])),
        ("pyEIT GREIT", lambda: theirs.solve(after, before)),
        repeats=400,
        burst=20,
    )
    goal = 15e-6
    yield Row(one.what, "≤ 15 µs", shown(one.ours_s), f"pyEIT GREIT: {shown(one.theirs_s)}", one.ours_s <= goal)
    batch = fastest(lambda: raster.images(frames), 100) / len(frames)
    yield Row("1000 frames to 1024 pixels, a frame", "≤ 4 µs", shown(batch), "none takes blocks", batch <= 4e-6)
    elements = fastest(lambda: linear.images(frames), _REPEATS) / len(frames)
    count = len(linear.problem.mesh.elements)
    yield Row(f"1000 frames to {count} elements in double precision, a frame", "", shown(elements))


def _criteria() -> Iterator[Row]:
    """What each criterion makes of the nine sites, from the changes measured at them and the channels' noise."""
    truth, nominal = loads(), imaging_problem(disc())
    changes = truth.noisy(nominal, 60.0, 4)
    weighted = imaging_problem(disc(), noise_variance=nominal.reference**2)
    sampled = replace(weighted, sample=changes.reshape(-1, changes.shape[2]))
    for criterion in Criterion:
        began = time.perf_counter()
        prepared: LinearReconstruction = GaussNewtonLaplace(choose=criterion).prepare(sampled)
        took = time.perf_counter() - began
        alone = [[prepared.images(frame[None])[0] for frame in frames] for frames in changes]
        figures = score(alone, nominal.mesh, truth.places)
        yield Row(
            f"gauss-newton-laplace, λ by {criterion}, nine sites, γ +50 %, 60 dB a channel",
            "",
            f"{shown(took)}; {figures.words()}; noise figure {prepared.choice.noise_figure:.2f}",
        )
