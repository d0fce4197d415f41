"""Readings that reciprocity makes equal, folded into one: nothing is lost, and their noise is seen."""

from dataclasses import replace

import numpy as np
import pytest

from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.inverse.dual import dual_matrix
from cbsr_qa.eit.inverse.priors import noser
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.inverse.readings import ReadingFold


def with_pattern(sensor: SensorType, drive, measure) -> SensorType:
    pattern = DrivePattern(sensor.pattern.electrode_count, tuple(drive), tuple(measure))
    return SensorType("other", sensor.radius_mm, 4.0, sensor.electrodes, pattern, sensor.response)


@pytest.fixture(scope="module")
def problems(pin_sensor) -> dict[str, ImagingProblem]:
    """Adjacent, with a mask and unequal noise, and with pairs turned round, doubled and skipping."""
    sensor = pin_sensor()
    random = np.random.default_rng(4)
    used = sensor.pattern.usable() & (random.random((16, 16)) < 0.8)
    variance = np.exp(random.normal(0, 1, (16, 16)))
    skipping = [(k, (k + 3) % 16) for k in range(16)]
    turned = [pair[::-1] if k % 3 == 0 else pair for k, pair in enumerate(skipping)]
    doubled = with_pattern(sensor, skipping, [*turned, (5, 2), (11, 8)])
    return {
        "adjacent": imaging_problem(sensor, image_size_mm=6.0),
        "masked": imaging_problem(sensor, used=used, noise_variance=variance, image_size_mm=6.0),
        "turned": imaging_problem(doubled, image_size_mm=6.0),
    }


NAMES = ("adjacent", "masked", "turned")


@pytest.mark.parametrize("name", NAMES)
def test_folded_readings_give_the_same_matrix(problems, name):
    problem = problems[name]
    fold, prior = ReadingFold.from_problem(problem), noser(problem.jacobian, 0.5)
    whole = dual_matrix(problem.jacobian, prior, 0.1, problem.noise_variance)
    folded = fold.unfold(dual_matrix(fold.rows(problem.jacobian), prior, 0.1, fold.variance))
    assert len(fold.first) < 0.6 * len(problem.reference) or name == "masked"
    assert np.abs(folded - whole).max() < 1e-10 * np.abs(whole).max()


@pytest.mark.parametrize("name", NAMES)
def test_sensitivities_within_a_group_are_equal(problems, name):
    jacobian, fold = problems[name].jacobian, ReadingFold.from_problem(problems[name])
    assert np.abs(jacobian - fold.sign[:, None] * jacobian[fold.first][fold.group]).max() < 1e-9 * jacobian.max()


@pytest.mark.parametrize("name", NAMES)
def test_means_weigh_by_information(problems, name):
    """Folding readings, then taking the matrix of the means, is taking the matrix of all."""
    problem, random = problems[name], np.random.default_rng(8)
    fold = ReadingFold.from_problem(problem)
    matrix, readings = random.standard_normal((5, len(fold.first))), random.standard_normal((7, len(fold.group)))
    assert np.allclose(fold.fold(readings) @ matrix.T, readings @ fold.unfold(matrix).T, rtol=1e-12, atol=1e-12)
    variance = np.ones(len(fold.group)) if problem.noise_variance is None else problem.noise_variance
    of_means = fold.unfold(np.eye(len(fold.first))) ** 2 @ variance
    assert np.allclose(of_means, fold.variance, rtol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_noise_is_told_from_readings_that_are_there_twice(problems, name):
    problem = problems[name]
    fold = ReadingFold.from_problem(problem)
    relative = np.ones(len(fold.group)) if problem.noise_variance is None else problem.noise_variance
    noise = 0.3 * np.sqrt(relative) * np.random.default_rng(2).standard_normal((500, len(relative)))
    seen, freedom = fold.noise(problem.reference + noise)
    assert seen == pytest.approx(0.09, rel=5 * np.sqrt(2 / freedom))
    assert ReadingFold.from_problem(problem).noise(problem.reference[None])[0] < 1e-20


def test_a_problem_that_contradicts_reciprocity_is_not_folded(problems):
    problem = problems["adjacent"]
    crooked = problem.reference.copy()
    crooked[3] *= 1.01
    fold = ReadingFold.from_problem(replace(problem, reference=crooked))
    assert np.array_equal(fold.first, np.arange(208))
    assert fold.noise(problem.reference[None]) == (0.0, 0)
