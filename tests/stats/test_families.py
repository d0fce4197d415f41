"""Families of distributions: densities, quantiles and moments that agree, and what samples say of them."""

from math import exp, log, pi, sqrt

import numpy as np
import pytest
from scipy import integrate, optimize, special, stats

from cbsr_qa.stats.averaged_bound import average, average_heaviest
from cbsr_qa.stats.families import Contaminated, Gumbel, LargestNormal, Student
from cbsr_qa.stats.family_posterior import find_posterior
from cbsr_qa.stats.intervals import one_sided_factor

FAMILIES = [
    LargestNormal(),
    LargestNormal(9),
    Student(5),
    Student(3),
    Student(5, 9),
    Gumbel(1),
    Gumbel(-1),
    Contaminated(0.1, 6),
]


@pytest.mark.parametrize("family", FAMILIES, ids=str)
def test_density_quantile_and_distribution_function_are_of_one_distribution(family):
    def integral(function, low=-np.inf, high=np.inf):
        return integrate.quad(lambda z: function(z) * exp(family.log_density(np.array(z))), low, high, limit=400)[0]

    assert integral(lambda z: 1.0, -60, 0) + integral(lambda z: 1.0, 0, 60) == pytest.approx(1, abs=1e-4)
    for share in (0.01, 0.3, 0.99):
        z = family.quantile(share)
        assert family.distribution_function(np.array([z]))[0] == pytest.approx(share, abs=1e-9)
        assert integral(lambda z: 1.0, -60, z) == pytest.approx(share, abs=2e-4)
        assert family.normal_scores(np.array([z]))[0] == pytest.approx(special.ndtri(share), abs=1e-6)
        assert family.mirror().quantile(1 - share) == pytest.approx(-z) or getattr(family, "values", 1) > 1
    mean, deviation = family.moments()
    z = np.array([family.quantile((k + 0.5) / 4000) for k in range(4000)])
    # The middle of each slice is close enough, but for the tails of Student's t.
    assert (z.mean(), z.std()) == pytest.approx((mean, deviation), abs=0.1 if family == Student(3) else 0.02)
    assert np.isfinite(family.log_density(np.array([-1e6, 1e6])).max())


@pytest.mark.parametrize("count", [3, 5, 30, 400])
def test_a_normal_sample_has_the_bound_of_the_noncentral_t_and_its_exact_evidence(count):
    values = 7 + 3 * np.random.default_rng(count).normal(size=count)
    posterior = find_posterior(values, LargestNormal())
    mean, deviation = values.mean(), values.std(ddof=1)
    bound = optimize.brentq(lambda limit: posterior.exceedance(limit, 0.99) - 0.05, mean, mean + 100 * deviation)
    factor = one_sided_factor(0.99, 0.95, count, count - 1)
    assert (bound - mean) / deviation == pytest.approx(factor, rel=5e-3)
    squares = (count - 1) * deviation**2
    half = (count - 1) / 2
    exact = special.gammaln(half) - half * log(pi) - 0.5 * log(count) - half * log(squares) - log(2)
    assert posterior.log_evidence == pytest.approx(exact, abs=2e-4)


def test_two_values_say_the_same_of_every_symmetric_family():
    """Berger, Pericchi & Varshavsky 1998: the evidence of two values is 1/(2 |x₁ − x₂|), whatever the family."""
    for family in (LargestNormal(), Gumbel(1)):
        assert find_posterior(np.array([1.0, 4.0]), family).log_evidence == pytest.approx(-log(6), abs=0.02)


def test_bounds_follow_unit_and_sign():
    values = np.random.default_rng(1).standard_t(4, 25)
    plain = average(values, 1, positive=False).find_bound(0.99, 0.05)
    assert average(3 * values - 50, 1, positive=False).find_bound(0.99, 0.05) == pytest.approx(
        3 * plain - 50, rel=1e-4
    )
    assert average(-values, -1, positive=False).find_bound(0.99, 0.05) == pytest.approx(plain, rel=1e-4)


def test_families_are_told_apart_where_a_lot_is_large_enough():
    random = np.random.default_rng(2)
    for draw, name in (
        (lambda: random.normal(size=250), "normal"),
        (lambda: np.exp(random.normal(0, 0.5, 250)), "log-normal"),
        (lambda: random.weibull(1.5, 250), "Weibull"),
        (lambda: random.gumbel(size=250), "Gumbel of largest"),
        (lambda: -random.gumbel(size=250), "Gumbel of smallest"),
    ):
        for sign in (1, -1):
            values = draw()
            assert average(values, sign, positive=values.min() > 0).shares()[0].family == name


@pytest.mark.rest
def test_the_heaviest_family_alone_has_exactly_the_stated_confidence():
    """Of 400 lots of Student's t with 3 degrees of freedom 95 % have a bound beyond the quantile."""
    random = np.random.default_rng(3)
    quantile = stats.t(3).ppf(0.99)
    held = [average_heaviest(random.standard_t(3, 20), 1).find_bound(0.99, 0.05) >= quantile for _ in range(400)]
    assert np.mean(held) == pytest.approx(0.95, abs=3 * sqrt(0.05 * 0.95 / 400))
