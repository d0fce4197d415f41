import re
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from disc_meshes import square_mesh
from pages import TOP

from cbsr_qa.domain.errors import ConfigError, NumericsError
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.inverse.iterative.absolute import Linearised, SheetModel, matern
from cbsr_qa.eit.inverse.problem import imaging_problem, target_signal
from cbsr_qa.eit.inverse.scaling import scale_of
from cbsr_qa.eit.mesh.sheet import sheet_mesh
from cbsr_qa.testing.numerics import assert_expected_order
from cbsr_qa_plugins.reconstruction.iterative import AbsoluteGaussNewton

_EVERY = np.ones((16, 16), dtype=bool)
#: States figures of the sensor below.
_PAGE = TOP / "docs" / "explanation" / "iterative-methods.md"
_UNIT = 3.7  # of the simulated voltages


def uneven(places_mm: np.ndarray) -> np.ndarray:
    """ln γ of a sheet that is about 15 % uneven."""
    x, y = places_mm.T / 50
    waves = 0.3 * np.sin(2.2 * x + 0.4) * np.cos(1.7 * y - 0.3)
    return waves + 0.25 * np.exp(-((x + 0.3) ** 2 + (y - 0.4) ** 2) / 0.08)


@dataclass(frozen=True)
class Sensor:
    """An uneven sensor, simulated on another and finer mesh than any that images it."""

    sensor_type: SensorType
    model: ForwardModel
    frame: np.ndarray

    def problem(self, used: np.ndarray | None = None) -> ImagingProblem:
        problem = imaging_problem(self.sensor_type, used=used, image_size_mm=6.0)
        return replace(problem, measured=self.frame[problem.used] / self.scale(problem))

    def scale(self, problem: ImagingProblem) -> float:
        return scale_of(self.frame, problem)


@pytest.fixture(scope="module")
def simulated(pin_sensor) -> Sensor:
    mesh = sheet_mesh(pin_sensor(), size_mm=3.3, order=2)
    contacts = np.exp(np.random.default_rng(3).uniform(np.log(0.2), np.log(2.0), 16))
    model = ForwardModel(mesh, pin_sensor().pattern, np.exp(uneven(mesh.centroids_mm)), contacts, order=2)
    clean = model.voltages()
    noise = (
        1e-3
        * np.abs(clean[pin_sensor().pattern.usable()]).mean()
        * np.random.default_rng(4).standard_normal((16, 16))
    )
    return Sensor(pin_sensor(), model, _UNIT * (clean + noise))


@pytest.fixture(scope="module")
def imaged(simulated):
    """The problem and the sheet that is found, from the readings used or from every one; each is made once."""

    @cache
    def make(every):
        problem = simulated.problem(_EVERY if every else None)
        return problem, AbsoluteGaussNewton().prepare(problem)

    return make


def nothing(problem: ImagingProblem) -> np.ndarray:
    return np.zeros((1, len(problem.reference)))


@pytest.mark.parametrize(("every", "allowed"), [(False, 0.03), (True, 0.04)], ids=["208", "256"])
def test_an_uneven_sheet_is_found(simulated, imaged, every, allowed):
    problem, prepared = imaged(every)
    true = uneven(problem.mesh.centroids_mm) + np.log(simulated.scale(problem) / _UNIT)
    found = np.log(prepared.absolute(nothing(problem))[0])
    areas = problem.mesh.areas_mm2 / problem.mesh.areas_mm2.sum()
    spread = np.sqrt(areas @ (true - areas @ true) ** 2)
    error = np.sqrt(areas @ (found - true) ** 2)
    assert error < allowed
    stated = rf"sheet that is {100 * spread:.0f} % uneven, [^.]*? found to {100 * error:.0f} % \(root mean square\)"
    assert re.search(stated, " ".join(_PAGE.read_text(encoding="utf-8").split()))
    assert prepared.reference.unexplained < 1e-3
    assert 0.1 < prepared.reference.residual < 1.5


def test_contacts_are_found_from_every_reading_with_their_error(simulated, imaged):
    problem, prepared = imaged(True)
    true = simulated.model.contact_impedance * _UNIT / simulated.scale(problem)
    wrong = np.log(prepared.contact_impedance() / true)
    error = np.sqrt(np.mean(wrong**2))
    assert error < 0.06
    assert f"from 0.2 to 2 mm are found to {100 * error:.0f} %" in _PAGE.read_text(encoding="utf-8")
    assert (np.abs(wrong) < 3 * prepared.reference.log_contact_error).all()
    assert prepared.reference.log_contact_error.max() < 0.4
    assert np.corrcoef(np.log(prepared.contact_impedance()), np.log(true))[0, 1] > 0.99


def test_contacts_no_reading_tells_are_refused(imaged, problem):
    _, prepared = imaged(False)
    assert prepared.reference.log_contact_error.min() > 0.9
    with pytest.raises(NumericsError, match="contact impedance of electrodes 0, 1, 2"):
        prepared.contact_impedance()
    with pytest.raises(NumericsError, match="contact impedance of electrodes"):
        AbsoluteGaussNewton().prepare(imaging_problem(problem.sensor_type, used=_EVERY)).contact_impedance()


@pytest.mark.rest
def test_images_do_not_depend_on_the_unit(simulated):
    problem = simulated.problem()
    changes = target_signal(problem, x_mm=15, y_mm=10, radius_mm=6.5, contrast=0.3)[None]
    found = []
    for factor in (1.0, 1e-6, 250.0):
        prepared = AbsoluteGaussNewton().prepare(replace(problem, measured=factor * problem.measured))
        found.append((prepared.images(factor * changes), factor * prepared.absolute(factor * changes)))
    for image, absolute in found[1:]:
        assert np.abs(image - found[0][0]).max() < 1e-7 * np.abs(found[0][0]).max()
        assert np.allclose(absolute, found[0][1], rtol=1e-7)


def test_derivatives_are_those_of_the_readings(problem):
    """Central differences come closer with the square of the step, for conductances and contacts at once."""
    model = SheetModel(imaging_problem(problem.sensor_type, used=_EVERY, image_size_mm=8.0), 0.15)
    random = np.random.default_rng(2)
    state = model.nominal.step(0.3 * random.standard_normal(len(model.nominal.unknowns)))
    direction = random.standard_normal(len(state.unknowns))
    slope = model.solve(state).jacobian() @ direction
    steps, errors = (0.1, 0.05, 0.025), []
    for step in steps:
        ahead, behind = (model.solve(state.step(sign * step * direction)).readings() for sign in (1, -1))
        errors.append(float(np.linalg.norm((ahead - behind) / (2 * step) - slope)))
    assert_expected_order(errors, steps, 2.0, 0.05)


def test_small_changes_are_imaged_by_the_first_step(problem):
    """The rest of the iteration is of second order in the change."""
    prepared = AbsoluteGaussNewton(noise_dB=120).prepare(problem)
    changes = target_signal(problem, x_mm=12, y_mm=-20, radius_mm=6.5, contrast=1e-3)
    step = prepared.before_load.matrix()[: len(problem.mesh.elements)] @ prepared.model.fold.fold(changes[None])[0]
    sizes, errors = (16.0, 8.0, 4.0), []
    for size in sizes:
        errors.append(np.abs(prepared.images(size * changes[None])[0] / size - step).max())
    assert_expected_order(errors, sizes, 1.0, 0.15)


@pytest.mark.rest
def test_strong_loads_keep_their_amplitude_where_a_step_saturates(simulated):
    problem = simulated.problem()
    covered = np.hypot(*(simulated.model.mesh.centroids_mm - [10.0, 5.0]).T) < 8
    pressed = simulated.model.with_values(conductance=simulated.model.conductance * np.where(covered, 4.0, 1.0))
    change = _UNIT * (pressed.voltages() - simulated.model.voltages())[problem.used] / simulated.scale(problem)
    prepared = AbsoluteGaussNewton(load_spread=0.5, load_length=0.2).prepare(problem)
    image = prepared.images(change[None])[0]
    step = prepared.before_load.matrix()[: len(image)] @ prepared.model.fold.fold(change[None])[0]
    inside = np.hypot(*(problem.mesh.centroids_mm - [10.0, 5.0]).T) < 5
    assert 1.5 < image[inside].mean() < 3.0  # true: 3
    assert step[inside].mean() < 0.6 * image[inside].mean()
    page = " ".join(_PAGE.read_text(encoding="utf-8").split())
    stated = re.search(r"is imaged as (\d+) % more \(mean within 5 mm of its centre\), by one step as (\d+) %", page)
    shares = [100 * image[inside].mean(), 100 * step[inside].mean()]
    assert [int(share) for share in stated.groups()] == pytest.approx(shares, abs=1)


@pytest.mark.rest
def test_every_frame_stands_for_itself(problem):
    prepared = AbsoluteGaussNewton().prepare(problem)
    one = target_signal(problem, x_mm=12, y_mm=-20, radius_mm=6.5, contrast=0.2)
    images = prepared.images(np.stack([one, 0 * one, -one]))
    assert not images[1].any()
    assert np.array_equal(images[0], prepared.images(one[None])[0])
    assert images[0].max() > 0 > images[2].min()
    assert prepared.images(np.zeros((0, 208))).shape == (0, images.shape[1])


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        pytest.param(
            lambda frame: np.roll(frame, 3, axis=1),
            "uncorrelated|explains the reference|did not converge",
            id="order",
            marks=pytest.mark.rest,
        ),
        pytest.param(lambda frame: -frame, "opposite polarity", id="polarity"),
        pytest.param(lambda frame: 0 * frame, "uncorrelated", id="zero"),
        pytest.param(
            lambda frame: np.random.default_rng(1).standard_normal(frame.shape),
            "uncorrelated|explains|converge",
            id="noise",
            marks=pytest.mark.rest,
        ),
    ],
)
def test_readings_of_no_such_sheet_are_refused(problem, simulated, spoil, reason):
    measured = spoil(simulated.frame)[problem.used]
    with pytest.raises(NumericsError, match=reason) as refused:
        AbsoluteGaussNewton(mesh_size=0.15).prepare(replace(problem, measured=measured))
    assert refused.value.remedy


def test_a_frame_no_sheet_explains_is_refused(problem):
    prepared = AbsoluteGaussNewton(mesh_size=0.15).prepare(problem)
    one = target_signal(problem, x_mm=12, y_mm=-20, radius_mm=6.5, contrast=0.2)
    with pytest.raises(NumericsError, match=r"explains frame 1|did not converge"):
        prepared.images(np.stack([one, np.roll(problem.reference, 31) - problem.reference]))


def test_too_few_iterations_are_an_error_not_an_image(simulated):
    with pytest.raises(NumericsError, match="did not converge: after 1 steps steps ran out") as refused:
        AbsoluteGaussNewton(iterations=1).prepare(simulated.problem())
    assert "noise_dB" in refused.value.remedy


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"noise_dB": -1.0}, "noise_dB is"),
        ({"spread": 0.0}, "spread is"),
        ({"length": 1e-310}, "length is"),
        ({"load_spread": float("inf")}, "load_spread is"),
        ({"load_spread": 1e-300}, "load_spread is"),
        ({"noise_figure": 0.0}, "noise_figure is"),
        ({"contact_spread": -1.0}, "contact_spread is"),
        ({"mesh_size": 0.5}, "mesh_size is"),
        ({"mesh_size": 0.0299}, "mesh_size is"),
        ({"iterations": 1001}, "iterations is"),
        ({"iterations": 0}, "iterations is"),
        ({"noise_figure": 1.0, "load_spread": 0.1}, "not both"),
    ],
)
def test_impossible_options_are_refused(options, reason):
    with pytest.raises(ConfigError, match=reason) as refused:
        AbsoluteGaussNewton(**options)
    assert refused.value.remedy


def test_a_noise_figure_out_of_reach_is_refused(problem):
    with pytest.raises(NumericsError, match="cannot be reached"):
        AbsoluteGaussNewton(noise_figure=1e-4).prepare(problem)


def test_what_is_beyond_numbers_is_refused_never_imaged(problem):
    prepared = AbsoluteGaussNewton(mesh_size=0.15).prepare(problem)
    one = target_signal(problem, x_mm=12, y_mm=-20, radius_mm=6.5, contrast=0.2)
    with pytest.raises(NumericsError, match=r"cannot be computed: readings of up to .*e\+29") as refused:
        prepared.images(1e300 * one[None])
    assert "units" in refused.value.remedy
    extreme = replace(problem, noise_variance=np.where(np.arange(208) % 2, 1e-300, 1e300), nominal=problem)
    with pytest.raises(NumericsError, match="absolute image") as refused:
        AbsoluteGaussNewton(mesh_size=0.15).prepare(extreme).images(one[None])
    assert refused.value.remedy
    before = prepared.before_load
    for variance in (np.inf, -1.0):
        with pytest.raises(NumericsError, match=r"noise variances of .* leave no finite numbers"):
            Linearised(before.solved, prepared.load, np.full(len(before.variance), variance))


def test_meshes_whose_covariance_does_not_fit_are_refused():
    with pytest.raises(NumericsError, match="dense covariance: 10082 elements"):
        matern(square_mesh(71), 0.1)
