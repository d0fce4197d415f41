"""Hard cases of statistics: tiny variances of huge values, extreme shares, noise without scatter."""

from typing import Any, Final

import mpmath
import numpy as np

from cbsr_qa.calibration.fits.agreement import Agreement, MeasuredRelaxation, compare_relaxations
from cbsr_qa.calibration.fits.common_relaxation import fit_common_relaxation
from cbsr_qa.calibration.fits.estimates import best_straight_line, slope
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.eit.inverse.readings import reading_noise
from cbsr_qa.stats.golden_lots import Ask, lot_limits
from cbsr_qa.stats.intervals import count_needed, one_sided_factor, two_sided_factor
from cbsr_qa.stats.lot_shapes import Distribution
from cbsr_qa.stats.variance_components import components
from cbsr_qa.studies.hard_cases.case import Answer, Area, answer_from_condition
from cbsr_qa.studies.hard_cases.exact import DIGITS, largest_relative_error, relative_error

AREA: Final = Area("statistics")
_CONFIDENCE: Final = "the stated confidence, by integration in twenty digits"
_SEED: Final = 20261121


def one_sided(coverage: float, confidence: float, count: int) -> Answer:
    """Confidence that mean + k s of so many values covers the share, by integration over s, less the nominal one."""
    factor = one_sided_factor(coverage, confidence, count, count - 1)
    with mpmath.workdps(20):
        z = mpmath.sqrt(2) * mpmath.erfinv(2 * mpmath.mpf(coverage) - 1)
        half_freedom = mpmath.mpf(count - 1) / 2
        scale = 2 * half_freedom**half_freedom / mpmath.gamma(half_freedom)

        def density(s: Any) -> Any:
            covered_chance = mpmath.ncdf((mpmath.mpf(factor) * s - z) * mpmath.sqrt(count))
            return covered_chance * scale * mpmath.exp((2 * half_freedom - 1) * mpmath.log(s) - half_freedom * s**2)

        width = 6 / mpmath.sqrt(4 * half_freedom)
        ends = sorted({max(mpmath.mpf(0), 1 - width), *(1 + width * share for share in (0, 0.3, 1, 3))})
        ends = [mpmath.mpf(0), *(mpmath.mpf(10) ** k for k in range(-6, 1)), 3, 9] if count < 4 else ends
        exact_confidence = mpmath.quad(density, ends)
        shortfall = float(abs(exact_confidence - mpmath.mpf(confidence)) / (1 - mpmath.mpf(confidence)))
    return Answer(shortfall, 1e-9, note=f"k = {factor:.10g}")


def two_sided(coverage: float, confidence: float, count: int) -> Answer:
    """Confidence that mean ± k s covers the share, by integration over the mean, less the nominal one."""
    factor, freedom = two_sided_factor(coverage, confidence, count, count - 1), count - 1
    with mpmath.workdps(20):
        usual = mpmath.sqrt(2) * mpmath.erfinv(mpmath.mpf(coverage))

        def share_held(z: Any) -> Any:
            away = z / mpmath.sqrt(count)
            reach = mpmath.findroot(lambda r: mpmath.ncdf(away + r) - mpmath.ncdf(away - r) - coverage, usual)
            least = mpmath.mpf(freedom) * reach**2 / mpmath.mpf(factor) ** 2
            return 2 * mpmath.npdf(z) * mpmath.gammainc(mpmath.mpf(freedom) / 2, least / 2, regularized=True)

        reached = mpmath.quad(share_held, [0, 2, 4, 9], maxdegree=4)
        shortfall = float(abs(reached - mpmath.mpf(confidence)) / (1 - mpmath.mpf(confidence)))
    return Answer(shortfall, 1e-7, note=f"k = {factor:.10g}")


def limits_of(values: list[float]) -> Answer:
    """Upper limit of a lot, mean + k s, against fifty digits; it is rounded outwards by at most 1 %."""
    runs = [[value] for value in values]
    limits = lot_limits(runs, runs, 1, Ask(0.95, 0.95, False, True, Distribution.NORMAL))
    if limits.upper is None:
        raise NumericsError(limits.why, remedy="propose limits from sensors that differ, in a unit of their size")
    with mpmath.workdps(DIGITS):
        exact = [mpmath.mpf(value) for value in values]
        mean = mpmath.fsum(exact) / len(exact)
        deviation = mpmath.sqrt(mpmath.fsum((x - mean) ** 2 for x in exact) / (len(exact) - 1))
        distance = one_sided_factor(0.95, 0.95, len(values), len(values) - 1) * deviation
        beyond = float((mpmath.mpf(limits.upper.limit) - mean - distance) / distance)
    error = beyond if beyond >= 0 else 1.0  # a limit within the exact one promises too much
    return Answer(error, 0.011, note="limits are rounded outwards to a hundredth of their distance from the mean")


@AREA.against("the same variances in fifty digits")
def variance_of_huge_values() -> Answer:
    """Values of 1e9 that differ by tenths: their squares have no digit of the difference."""
    runs = [[1e9 + 0.5 * k, 1e9 + 0.5 * k + 0.1 * (k % 3)] for k in range(8)]
    variance = components(runs)
    with mpmath.workdps(DIGITS):
        means = [mpmath.fsum(mpmath.mpf(x) for x in run) / 2 for run in runs]
        middle = mpmath.fsum(means) / 8
        between_variance = mpmath.fsum((mean - middle) ** 2 for mean in means) / 7
        within_variance = (
            mpmath.fsum((mpmath.mpf(x) - m) ** 2 for run, m in zip(runs, means, strict=True) for x in run) / 8
        )
    # Sensors' means are numbers of 1e9 themselves, and carry their rounding.
    condition = 2 * 1e9 / float(mpmath.sqrt(within_variance))
    error = largest_relative_error([variance.between, variance.within or 0.0], [between_variance, within_variance])
    return answer_from_condition(error, condition)


@AREA.against(_CONFIDENCE)
def tolerance_factor_of_a_million_sensors() -> Answer:
    """A noncentral t with a million degrees of freedom, 1600 standard deviations from zero."""
    return one_sided(0.95, 0.95, 1_000_000)


@AREA.against(_CONFIDENCE)
def tolerance_factor_of_three_sensors() -> Answer:
    """Three sensors, a share of 1e-6 outside, a doubt of 1e-3: a factor of 151."""
    return one_sided(0.999999, 0.999, 3)


@AREA.against(_CONFIDENCE)
def two_sided_tolerance_factors() -> Answer:
    """Factors that are found by a search around an integral."""
    return two_sided(0.95, 0.95, 10)


@AREA.against("the binomial law in fifty digits")
def sensors_for_rare_failures() -> Answer:
    """All but 1e-12 of sensors: billions are needed, and one minus the share has four digits left."""
    sensor_count = count_needed(1 - 1e-12, 0.95, 2)
    with mpmath.workdps(DIGITS):
        outside_share = 1 - mpmath.mpf(1 - 1e-12)

        def doubt(x: Any) -> Any:
            """Chance that fewer than two of x/p sensors are outside, beyond the one allowed."""
            count = x / outside_share
            return (1 - outside_share) ** (count - 1) * (1 - outside_share + x) - (1 - mpmath.mpf(0.95))

        truth = mpmath.ceil(mpmath.findroot(doubt, 4.7) / outside_share)
    # 1 − coverage is exact for a coverage above one half: nothing of it may be lost.
    return answer_from_condition(relative_error(sensor_count, truth), 1.0)


@AREA.against("mean and deviation in fifty digits")
def limits_of_a_narrow_lot() -> Answer:
    """A lot at 1e9 that spreads by hundredths."""
    return limits_of([1e9 + 0.01 * k for k in range(8)])


@AREA.refuses(NumericsError)
def limits_of_identical_sensors() -> None:
    """A lot without any spread has no distribution."""
    limits_of([0.1 * 3] * 8)


@AREA.refuses(NumericsError)
def limits_of_values_that_underflow() -> None:
    """Variances of values of 1e-300 are zero: such a lot looks as if it had no spread."""
    limits_of([1e-300 * k for k in range(1, 9)])


@AREA.against("11/10, exactly")
def slope_on_a_huge_offset() -> Answer:
    """Rounding of places about their mean, times a level of 1e9, can be larger than any slope."""
    x, y = 1e6 + np.arange(5.0), 1e9 + np.array([0.0, 1.0, 2.0, 3.0, 4.5])
    condition = 1e9 / 4.5 + 1e6 / 4
    truth = mpmath.mpf(11) / 10
    return answer_from_condition(relative_error(slope(x.tolist(), y.tolist()).value, truth), condition)


@AREA.against("half the sagitta of a parabola")
def nonlinearity_far_from_zero() -> Answer:
    """The deviation from a line whose intercept is a million times as large."""
    x = np.arange(5.0)
    line = best_straight_line((1e6 + x).tolist(), (4e6 + x**2 / 1024).tolist())
    condition = 4e6 / (2 / 1024)
    return answer_from_condition(relative_error(line.largest, mpmath.mpf(2) / 1024), condition)


@AREA.against("the same readings without offset, over times from zero")
def noise_on_an_offset_of_a_million() -> Answer:
    """Noise on a million times its size, about a drift over times since 1970."""
    offset, frames = 1e6, 60
    readings = np.random.default_rng(_SEED).standard_normal((frames, 25))
    time_s: Array = np.arange(float(frames))
    plain_variance = reading_noise(readings, time_s).variance
    offset_variance = reading_noise(offset + readings, 1.7e9 + time_s).variance
    condition = 2 * offset / float(np.sqrt(plain_variance.min()))
    return answer_from_condition(largest_relative_error(offset_variance, plain_variance.tolist()), condition)


@AREA.refuses(NumericsError)
def readings_without_noise() -> None:
    """Readings that never change would have infinite weight."""
    reading_noise(np.full((10, 20), 0.1), np.arange(10.0))


@AREA.against("equal is equivalent, unequal is different")
def equivalence_without_noise() -> Answer:
    """A test of equivalence whose standard errors are rounding."""
    time_s: Array = 2.5 * np.arange(25.0)
    reference, same, other = (
        MeasuredRelaxation(fit_common_relaxation([(time_s, 1 + share * np.exp(-time_s / 20))]), 60.0)
        for share in (0.3, 0.3, 0.6)
    )
    wrong_count = int(compare_relaxations(reference, same).shape is not Agreement.EQUIVALENT)
    wrong_count += compare_relaxations(reference, other).shape is not Agreement.DIFFERENT
    return Answer(float(wrong_count), 0.0, unit="wrong statements")
