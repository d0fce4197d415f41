"""Rules by which a number agrees with a printed one; each is a comparison of numbers and nothing else."""

from math import hypot, sqrt

from cbsr_qa.domain.numbers import finite_numbers


def within_deviation(value: float, printed: float, deviation: float) -> bool:
    """Say whether a value is at most one printed deviation from the printed one."""
    return abs(value - printed) <= deviation


def within_digits(value: float, printed: float, half_digit: float, uncertainty: float) -> bool:
    """Say whether a value agrees with one that is printed without a deviation.

    Parameters
    ----------
    half_digit : half a unit of the last printed digit: the printed number may be rounded by as much.
    uncertainty : standard deviation of our value; two of them are allowed.
    """
    return abs(value - printed) <= half_digit + 2 * uncertainty


def ranges_of(
    value: float, ranges: tuple[tuple[str, float, float], ...], uncertainty: float = 0.0
) -> tuple[str, ...]:
    """Return the names of the ranges (name, low, high) a value is in, give or take its uncertainty."""
    return tuple(name for name, low, high in ranges if low - uncertainty <= value <= high + uncertainty)


def deviations_agree(ours: float, count: int, printed: float, printed_count: int) -> bool:
    """Say whether two standard deviations are within two standard errors of their difference.

    The standard error of a deviation s of n normal values is s / √(2 (n − 1)).

    Parameters
    ----------
    count, printed_count : numbers of values n, at least 2.

    Raises
    ------
    NumericsError
        If a deviation is not finite.
    """
    finite_numbers([ours, printed], "deviations")
    errors = ours / sqrt(2 * (count - 1)), printed / sqrt(2 * (printed_count - 1))
    return abs(ours - printed) <= 2 * hypot(*errors)
