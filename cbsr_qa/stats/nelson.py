"""Nelson's eight tests for special causes (Journal of Quality Technology 16, 1984, 237), on standardised points.

A signal is given at the point that completes a pattern.

Mean and deviation of the range of n normal values, by quadrature:

    d₂ = ∫ [1 − Φⁿ − (1 − Φ)ⁿ] dx,   d₃² = E R² − d₂²,
    E R² = 2 ∫∫_{x<y} [1 − Φ(y)ⁿ − (1 − Φ(x))ⁿ + (Φ(y) − Φ(x))ⁿ] dx dy

Source: Tippett 1925; d₂* = √(d₂² + d₃²/g) of g ranges is Duncan's 1955 (AIAG MSA 4th edition, appendix C).
"""

from collections.abc import Callable, Collection
from enum import StrEnum
from functools import lru_cache
from math import sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import special

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array

_FAR = 9.0
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(200)
MOST = 1000  #: largest subgroup with a range chart


@lru_cache(maxsize=64)
def d2_d3(count: int) -> tuple[float, float]:
    """Return mean and deviation of the range of ``count`` standard normal values; NumericsError beyond 2 to 1000."""
    if not 2 <= count <= MOST:
        raise NumericsError(f"range: {count} values; allowed are 2 to {MOST}")
    y, weights = _FAR * _NODES, _FAR * _WEIGHTS
    chance_below, chance_above = special.ndtr(y), special.ndtr(-y)
    mean = float(np.sum(weights * (1 - chance_below**count - chance_above**count)))
    # For each y the inner variable runs from −9 to y.
    x = -_FAR + (y[:, None] + _FAR) * (_NODES + 1) / 2
    inner = (y[:, None] + _FAR) / 2 * _WEIGHTS
    chance_between = special.ndtr(y)[:, None] - special.ndtr(x)
    integrand = 1 - (chance_below**count)[:, None] - special.ndtr(-x) ** count + chance_between**count
    square = 2 * float(np.sum(weights[:, None] * inner * integrand))
    return mean, sqrt(square - mean**2)


def d2_star(count: int, ranges: int) -> float:
    """Return d₂* for the mean of this many ranges, which makes (R̄/d₂*)² unbiased for the variance."""
    mean, deviation = d2_d3(count)
    return sqrt(mean**2 + deviation**2 / ranges)


Flags = NDArray[np.bool_]


class Rule(StrEnum):
    """The eight tests."""

    BEYOND = "1: one point beyond 3σ"
    SAME_SIDE = "2: nine points in a row on one side of the centre"
    TREND = "3: six points in a row rising or falling"
    ALTERNATING = "4: fourteen points in a row alternating up and down"
    TWO_OF_THREE = "5: two of three points beyond 2σ on one side"
    FOUR_OF_FIVE = "6: four of five points beyond 1σ on one side"
    HUGGING = "7: fifteen points in a row within 1σ of the centre"
    AVOIDING = "8: eight points in a row beyond 1σ, on either side"


ALL_RULES = tuple(Rule)


def nelson(standard: Array, rules: Collection[Rule] = ALL_RULES) -> dict[Rule, Flags]:
    """Return the points (n,) at which each requested rule signals, of (point − centre)/σ (n,)."""
    return {rule: _TESTS[rule](standard) for rule in Rule if rule in rules}


def _last(flags: Flags, window: int) -> NDArray[np.intp]:
    """Return how many of the last ``window`` flags, up to and with each one, are set."""
    counts = np.concatenate([np.zeros(window, dtype=np.intp), np.cumsum(flags)])
    ends: NDArray[np.intp] = counts[window:] - counts[:-window]
    return ends


def _find_lasting(flags: Flags, window: int) -> Flags:
    """Return where all of the last ``window`` flags are set."""
    is_lasting: Flags = _last(flags, window) == window
    return is_lasting


def _steps(z: Array) -> Array:
    """Differences to the point before; not a number for the first."""
    return np.diff(z, prepend=np.nan)


def _turns(z: Array) -> Flags:
    steps = _steps(z)
    return np.concatenate([[False], steps[1:] * steps[:-1] < 0])[: len(z)]


def _test_both_sides(test: Callable[[Array], Flags]) -> Callable[[Array], Flags]:
    return lambda z: test(z) | test(-z)


def _flag_beyond(z: Array, line: float, least: int, window: int) -> Flags:
    return (z > line) & (_last(z > line, window) >= least)


#: The tests, each with its probability of a false alarm at a point.
_TESTS: Final[dict[Rule, Callable[[Array], Flags]]] = {
    Rule.BEYOND: lambda z: np.abs(z) > 3,  # 0.0027
    Rule.SAME_SIDE: _test_both_sides(lambda z: _find_lasting(z > 0, 9)),  # 2/2⁹ = 0.0039
    Rule.TREND: _test_both_sides(lambda z: _find_lasting(_steps(z) > 0, 5)),  # 2/6! = 0.0028
    Rule.ALTERNATING: lambda z: _find_lasting(_turns(z), 12),  # 2 E₁₄/14! = 0.0046, E₁₄ alternating orders
    Rule.TWO_OF_THREE: _test_both_sides(
        lambda z: _flag_beyond(z, 2, 2, 3)
    ),  # 2 q (1 − (1 − q)²) = 0.0020, q = 0.0228
    Rule.FOUR_OF_FIVE: _test_both_sides(lambda z: _flag_beyond(z, 1, 4, 5)),  # 2 q P(3 or 4 of 4) = 0.0044, q = 0.159
    Rule.HUGGING: lambda z: _find_lasting(np.abs(z) < 1, 15),  # 0.683¹⁵ = 0.0033
    Rule.AVOIDING: lambda z: _find_lasting(np.abs(z) > 1, 8),  # 0.317⁸ = 0.0001
}
