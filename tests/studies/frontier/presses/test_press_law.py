"""Laws with a floor: exact ones are found again, forecasts scale as they must, and limits hold as often as stated."""

import numpy as np
import pytest

from benchmarks.press_forecasts import LAWS, judge
from cbsr_qa.studies.frontier.presses.law import LearningCurve, fit_laws

NUMBERS = np.array([9.0, 18.0, 36.0, 72.0, 144.0, 288.0])


def curve(error_mm, stderr=1e-3, numbers=NUMBERS, degrees=50.0):
    errors = np.array([error_mm(number) for number in numbers])
    return LearningCurve(numbers, errors, stderr**2 * np.eye(len(numbers)), degrees)


@pytest.mark.parametrize(
    "law",
    [
        lambda n: 12 * n**-0.3,
        lambda n: 20 * n**-0.6 + 1.5,
        lambda n: np.hypot(30 * n**-0.7, 2.0),
    ],
)
@pytest.mark.parametrize("number", [400.0, 900.0])
def test_an_exact_law_is_forecast(law, number):
    laws = fit_laws(curve(law))
    low, best, high = laws.forecast_error(number)
    assert low < law(number) < high
    assert best == pytest.approx(law(number), rel=0.03)
    least, needed, most = laws.forecast_number(law(number))
    assert least < number < most
    assert least < needed < most


def test_the_error_of_a_number_needs_that_number():
    laws = fit_laws(curve(lambda n: np.hypot(30 * n**-0.7, 2.0)))
    low, best, high = laws.forecast_error(500.0)
    assert laws.forecast_number(low)[0] == pytest.approx(500.0)
    assert laws.forecast_number(best)[1] == pytest.approx(500.0)
    assert laws.forecast_number(high)[2] == pytest.approx(500.0)


def test_forecasts_scale_with_errors_and_numbers():
    laws = fit_laws(curve(lambda n: 20 * n**-0.6 + 1.5))
    scaled = fit_laws(curve(lambda n: 7 * (20 * (n / 3) ** -0.6 + 1.5), numbers=3 * NUMBERS))
    assert scaled.forecast_error(2700.0) == pytest.approx([7 * error for error in laws.forecast_error(900.0)])
    assert scaled.forecast_number(7 * 1.9) == pytest.approx([3 * number for number in laws.forecast_number(1.9)])


def test_less_sure_errors_have_wider_limits():
    def limits(stderr, degrees):
        return fit_laws(curve(lambda n: 12 * n**-0.3, stderr, degrees=degrees)).forecast_error(900.0)

    low, _, high = limits(0.02, 50.0)
    for wider in (limits(0.05, 50.0), limits(0.02, 3.0)):
        assert wider[0] < low
        assert wider[2] > high


def test_no_law_is_below_its_floor():
    low, _, _ = fit_laws(curve(lambda n: 20 * n**-0.6 + 1.5)).forecast_error(1e12)
    assert fit_laws(curve(lambda n: 20 * n**-0.6 + 1.5)).forecast_number(0.99 * low) == (np.inf, np.inf, np.inf)


def test_first_numbers_that_follow_no_law_are_left_out():
    """Nine presses tell nothing: their error is that of guessing."""
    laws = fit_laws(curve(lambda n: 12 * n**-0.3 if n > 20 else 4.0))
    assert laws.forecast_error(900.0)[1] == pytest.approx(12 * 900**-0.3, rel=0.03)


@pytest.mark.parametrize(
    "errors", [curve(lambda n: 2.0 + 3 * (n == 72)), curve(lambda n: n**-0.3, numbers=NUMBERS[:3])]
)
def test_without_a_law_nothing_is_forecast(errors):
    assert fit_laws(errors) is None


@pytest.mark.rest
@pytest.mark.parametrize("law", [LAWS[1], LAWS[5]], ids=lambda law: law.name)
def test_limits_hold_as_often_as_stated(law):
    """Of 40 recordings, 95 % are 33 or more with a probability of 0.999. ``make soak`` has more of all kinds."""
    for target, judged in judge(law, 500, False, 40):
        assert sum(one.right for one in judged) >= 33, target
        if target == "below the floor":
            assert sum(one.answer == "limits" for one in judged) <= 5
