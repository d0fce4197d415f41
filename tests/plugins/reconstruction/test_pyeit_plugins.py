"""pyEIT as a plugin: the same electrodes, signs and readings, its own images, and a remedy where it is missing."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from tiers import rest_but

from cbsr_qa.domain.errors import ConfigError, NumericsError
from cbsr_qa.domain.geometry.outlines import Polygon
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.sensor.patterns import DrivePattern, adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import Response, SensorType, polygon_sensor
from cbsr_qa.eit.inverse.overlap import overlap_fractions
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa_plugins.reconstruction.pyeit import (
    PyeitGreit,
    PyeitJac,
    PyeitProblem,
    _interpolate_raster,
    pyeit_problem,
    quiet,
    solver,
)

_SIZE = 0.12


def sensor(*, pattern: DrivePattern | None = None, first_angle_deg=0.0, counterclockwise=True) -> SensorType:
    layout = ElectrodeLayout(16, ElectrodeKind.PIN, 48.0, 0.65, first_angle_deg, counterclockwise)
    return SensorType("pins", 50.0, 4.0, layout, pattern or adjacent_pattern(16), Response.AUTO)


def readings(given: PyeitProblem) -> np.ndarray:
    with quiet():
        return np.asarray(solver("pyeit.eit.fem:EITForward", given).solve_eit(perm=1))


@pytest.fixture(scope="module", autouse=True)
def pyeit():
    return pytest.importorskip("pyeit", reason="pyEIT is an extra")


@pytest.fixture(scope="module")
def problem():
    return imaging_problem(sensor(), image_size_mm=8.0)


@pytest.mark.parametrize(
    "of",
    [
        pytest.param(
            sensor(first_angle_deg=33.0, counterclockwise=False), id="clockwise, turned", marks=pytest.mark.rest
        ),
        pytest.param(
            sensor(
                pattern=DrivePattern(
                    16, tuple((k, (k + 8) % 16) for k in range(16)), tuple(((k + 1) % 16, k) for k in range(16))
                )
            ),
            id="opposite drive, measured backwards",
        ),
    ],
)
def test_readings_have_our_order_sign_and_size(of):
    """Point electrodes on its coarse mesh against pins on ours: half a per cent."""
    ours = imaging_problem(of, image_size_mm=10.0)
    theirs = readings(pyeit_problem(ours, 0.07))
    assert np.linalg.norm(theirs - ours.reference) < 0.01 * np.linalg.norm(ours.reference)


@pytest.mark.rest
def test_masked_readings_are_not_in_the_protocol(problem):
    used = problem.used.copy()
    used[4], used[:, 9], used[0, 5] = False, False, False
    some = imaging_problem(problem.sensor_type, used=used, image_size_mm=8.0)
    whole = readings(pyeit_problem(problem, _SIZE))
    masked = readings(pyeit_problem(some, _SIZE))
    assert np.allclose(masked, whole[used[problem.used]], rtol=1e-9)


@pytest.mark.rest
def test_jac_images_are_its_own_averaged_over_our_elements(problem):
    prepared = PyeitJac(p=0.4, lamb=0.02, mesh_size=_SIZE).prepare(problem)
    given = pyeit_problem(problem, _SIZE)
    jac = solver("pyeit.eit.jac:JAC", given)
    with quiet():
        jac.setup(p=0.4, lamb=0.02, method="kotre", perm=1, jac_normalized=False)
    changed = problem.reference * (1 + 0.01 * np.sin(np.arange(208)))
    theirs = jac.solve(changed, problem.reference, normalize=False)
    ours = prepared.images((changed - problem.reference)[None])[0]
    assert np.abs(ours - overlap_fractions(problem.mesh, given.elements) @ theirs).max() < 1e-12 * np.abs(ours).max()
    assert prepared.choice.value == 0.02


def test_greit_answers_on_our_mesh_what_it_answers_on_its_raster(problem):
    prepared = PyeitGreit(mesh_size=_SIZE).prepare(problem)
    given = pyeit_problem(problem, _SIZE)
    greit = solver("pyeit.eit.greit:GREIT", given)
    with quiet():
        greit.setup(p=0.5, lamb=0.01, perm=1)
    changed = problem.reference * (1 + 0.01 * np.sin(np.arange(208)))
    theirs = greit.solve(changed, problem.reference, normalize=False)
    ours = prepared.images((changed - problem.reference)[None])[0]
    places = 50 * np.column_stack([greit.xg.ravel(), greit.yg.ravel()])
    for element in np.flatnonzero(np.hypot(*problem.mesh.centroids_mm.T) < 30)[::20]:
        near = np.argsort(np.hypot(*(places - problem.mesh.centroids_mm[element]).T))[:4]
        assert theirs[near].min() - 1e-12 <= ours[element] <= theirs[near].max() + 1e-12


def test_interpolation_between_pixels_is_exact_for_planes():
    x, y = np.linspace(-1, 1, 9, endpoint=False), np.linspace(-1, 1, 7, endpoint=False)
    points = np.random.default_rng(0).uniform(-0.9, 0.6, (30, 2))
    raster = (2 + 3 * x[None] - y[:, None]).ravel()
    assert np.allclose(_interpolate_raster(x, y, points) @ raster, 2 + 3 * points[:, 0] - points[:, 1], rtol=1e-13)
    beyond = _interpolate_raster(x, y, np.array([[5.0, 5.0]])) @ raster
    assert beyond == pytest.approx(2 + 3 * x[-1] - y[-1])


def test_it_is_neither_heard_nor_felt(problem, capfd):
    before = np.random.get_state()[1].copy()  # noqa: NPY002 - what its mesher draws from
    PyeitGreit(mesh_size=0.17).prepare(problem)
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("method", "key", "value"),
    [
        *((method, *wrong) for method in (PyeitJac, PyeitGreit) for wrong in (
            ("lamb", -1.0), ("lamb", float("nan")), ("lamb", 0.0), ("lamb", 1e200), ("p", 2.0), ("mesh_size", 0.5)
        )),
        (PyeitGreit, "n", 3),
        (PyeitGreit, "n", 3.5),
        (PyeitGreit, "ratio", 0.0),
        (PyeitGreit, "s", float("nan")),
    ],
)  # fmt: skip
def test_impossible_options_are_refused(method, key, value):
    with pytest.raises(ConfigError, match=re.escape(f"{key} is {value}")):
        method(**{key: value})


@pytest.mark.parametrize("method", [PyeitJac, PyeitGreit])
@pytest.mark.parametrize("p", rest_but({0.5}, [0.0, 0.5, 1.0]))
def test_what_rounding_alone_would_decide_is_refused(problem, method, p):
    """And what is not refused is the same image when the Jacobian moves in its last digits."""
    with pytest.raises(NumericsError, match=r"too small: rounding would decide|is singular") as refused:
        method(lamb=1e-30, p=p, mesh_size=0.17).prepare(problem)
    least = float(re.search(r"at least (\S+)", refused.value.remedy)[1])
    given = pyeit_problem(problem, 0.17)
    jac = solver("pyeit.eit.jac:JAC", given)
    with quiet():
        jac.setup(p=p, lamb=1.1 * least, method="kotre", perm=1, jac_normalized=False)
    moved = jac.J * (1 + 1e-15 * np.random.default_rng(0).choice([-1, 1], jac.J.shape))
    apart = np.abs(jac._compute_h(moved, p, 1.1 * least) - jac.H).max()
    if method is PyeitJac:
        assert apart < 0.05 * np.abs(jac.H).max()
    method(lamb=1.1 * least, p=p, mesh_size=0.17).prepare(problem)


def test_what_it_cannot_do_is_refused_with_a_remedy(problem):
    driven = replace(
        problem,
        used=np.ones((16, 16), dtype=bool),
        jacobian=np.ones((256, problem.jacobian.shape[1])),
        reference=np.ones(256),
    )
    with pytest.raises(NumericsError, match="touch a driven electrode"):
        PyeitJac().prepare(driven)
    square = Polygon(((-40.0, -40.0), (40.0, -40.0), (40.0, 40.0), (-40.0, 40.0)))
    layout = ElectrodeLayout(16, ElectrodeKind.PIN, 35.0, 0.65, 0.0, True)
    of_square = replace(problem, sensor_type=polygon_sensor("square", square, 4.0, layout, adjacent_pattern(16)))
    with pytest.raises(NumericsError, match="is not round"):
        PyeitGreit().prepare(of_square)


def test_where_it_is_not_installed_it_says_how_to(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyeit", None)
    for method in (PyeitJac, PyeitGreit):
        with pytest.raises(NumericsError, match=r"pip install 'cbsr-qa\[pyeit\]'"):
            method()
