"""The map of a sensor's response against a dense computation, one normal distribution a process."""

from itertools import product

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from cbsr_qa.calibration.sheet.response_map import learn_response
from cbsr_qa.domain.errors import CalibrationError

RADIUS_MM = 50.0
LENGTHS = (0.16, 0.22, 0.3, 0.4, 0.54, 0.72, 1.0, 1.4)
DEVIATIONS = (0.01, 0.02, 0.035, 0.06, 0.1, 0.15, 0.22, 0.32, 0.45)
SCATTERS = (0.0, 0.005, 0.01, 0.02, 0.04)
VAGUE = 1e3  # variance of the mean, of which nothing is known
THERE_MM = np.array([[0.0, 0.0], [10.0, 5.0], [30.0, -20.0], [0.0, 40.0], [45.0, 0.0]])
BEND_STDERR = 0.02


def kernels(apart):
    yield np.exp(-(apart**2) / 2)
    yield (1 + 5**0.5 * apart + 5 / 3 * apart**2) * np.exp(-(5**0.5) * apart)


def dense(places, values, variance, bend):
    """Mean and variance at THERE_MM and of the bend, over all processes of the documented grid and priors."""
    every, n = np.concatenate([places, THERE_MM]), len(values)
    apart = np.hypot(*(every[:, None] - every[None]).transpose(2, 0, 1)) / RADIUS_MM
    column = np.concatenate([bend, np.zeros(len(THERE_MM))])
    score, means, variances = [], [], []
    for length, deviation, scatter in product(LENGTHS, DEVIATIONS, SCATTERS):
        for kernel in kernels(apart / length):
            prior = deviation**2 * kernel + VAGUE + BEND_STDERR**2 * np.outer(column, column)
            # What is asked for: the map, and the multiple of the bend as the last unknown.
            across = np.column_stack([prior[:n, n:], BEND_STDERR**2 * bend])
            seen = prior[:n, :n] + np.diag(variance + scatter**2)
            solved = np.linalg.solve(seen, np.column_stack([across, values]))
            own = np.append(np.diag(prior)[n:], BEND_STDERR**2)
            likelihood = multivariate_normal(np.zeros(n), seen).logpdf(values)
            score.append(likelihood + np.log(deviation / (1 + (deviation / 0.2) ** 2)) - scatter / 0.02)
            means.append(across.T @ solved[:, -1])
            variances.append(own - (across * solved[:, :-1]).sum(axis=0))
    weight = np.exp(np.array(score) - max(score))
    weight /= weight.sum()
    mean = weight @ np.array(means)
    return mean, weight @ (np.array(variances) + (np.array(means) - mean) ** 2)


SCATTERED = np.random.default_rng(1).uniform(-30, 30, (10, 2))


@pytest.mark.parametrize(
    "places",
    [
        SCATTERED,
        SCATTERED[:3],
        np.tile([[5.0, 5.0]], (5, 1)),
        np.repeat([[0.0, 0.0], [20.0, 0.0]], 3, axis=0),
        np.column_stack([np.linspace(-30, 30, 7), np.zeros(7)]),
    ],
    ids=["ten places", "three places", "one place", "two places", "a line"],
)
def test_map_and_error_are_those_of_all_processes(places):
    random = np.random.default_rng(7)
    count = len(places)
    values = 0.3 + 0.15 * np.sin(places[:, 0] / 15) + 0.02 * random.standard_normal(count)
    bend = 1 / np.linspace(0.05, 0.2, count) - 10
    variance = np.full(count, 1e-4)
    mean, spread = dense(places, values, variance, bend)
    found = learn_response(places, values, variance, radius_mm=RADIUS_MM, bend=bend, bend_stderr=BEND_STDERR)
    ours, ours_spread = found.predict(THERE_MM)
    assert ours == pytest.approx(mean[:-1], abs=5e-4)
    assert np.sqrt(ours_spread) == pytest.approx(np.sqrt(spread[:-1]), rel=0.012)
    bent, its_variance = found.bend
    assert bent == pytest.approx(mean[-1], abs=0.01 * spread[-1] ** 0.5)
    assert its_variance == pytest.approx(spread[-1], rel=0.024)


NINE = np.array([(0, 0), (30, 0), (-30, 0), (15, 15), (-15, 15), (15, -15), (-15, -15), (0, 30), (0, -30)], float)
NOISE = 0.01


def drawn(random):
    """A sheet of the documented grid and priors: its loads at nine places, and its response at fifteen others."""
    weight = np.array(DEVIATIONS) / (1 + (np.array(DEVIATIONS) / 0.2) ** 2)
    deviation = random.choice(DEVIATIONS, p=weight / weight.sum())
    weight = np.exp(-np.array(SCATTERS) / 0.02)
    scatter = random.choice(SCATTERS, p=weight / weight.sum())
    radius, angle = 40 * np.sqrt(random.uniform(size=15)), random.uniform(0, 2 * np.pi, 15)
    others = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    every = np.concatenate([NINE, others])
    apart = np.hypot(*(every[:, None] - every[None]).transpose(2, 0, 1)) / RADIUS_MM
    kernel = list(kernels(apart / random.choice(LENGTHS)))[random.integers(2)]
    response = deviation * np.linalg.cholesky(kernel + 1e-9 * np.eye(len(every))) @ random.standard_normal(len(every))
    values = response[:9] + np.hypot(NOISE, scatter) * random.standard_normal(9)
    return values, others, response[9:]


@pytest.mark.rest
def test_nine_loads_leave_the_stated_errors_on_sheets_drawn_as_assumed():
    """Sheets smoother than most lie within their intervals too often; all of them together must not."""
    sheets, inside = 40, []
    for seed in range(sheets):
        values, others, response = drawn(np.random.default_rng([11, seed]))
        mean, variance = learn_response(NINE, values, np.full(9, NOISE**2), radius_mm=RADIUS_MM).predict(others)
        off = np.abs(response - mean) / np.sqrt(variance)
        inside.append([np.mean(off <= 1), np.mean(off <= 1.96)])
    shares, errors = np.mean(inside, axis=0), np.std(inside, axis=0) / np.sqrt(sheets)
    # Of 210 such sheets 75.4 ± 1.3 and 94.8 ± 0.7 %: a mixture has longer tails than a normal distribution, and so
    # more within one deviation.
    assert np.all(np.abs(shares - (0.75, 0.95)) < 3 * errors)
    assert np.all(errors < (0.04, 0.03))


@pytest.mark.parametrize("where", ["place", "response", "variance"])
def test_a_load_that_is_no_number_is_refused(where):
    places, values, variance = 10.0 * np.eye(4, 2), np.zeros(4), np.zeros(4)
    {"place": places, "response": values, "variance": variance}[where][1] = np.nan
    with pytest.raises(CalibrationError, match="not a finite number"):
        learn_response(places, values, variance, radius_mm=RADIUS_MM)
