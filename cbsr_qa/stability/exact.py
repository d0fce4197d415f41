"""Truth in fifty digits: numbers and figures worked out with mpmath from the very doubles a case was given."""

from collections.abc import Iterable, Sequence
from typing import Any

import mpmath
import numpy as np
from numpy.typing import NDArray

#: Digits that truth is worked out with.
DIGITS = 50


def relative_error(found: float, truth: Any) -> float:  # an mpmath number
    """Difference of a number from the truth over the truth's size; over 1 where the truth is zero."""
    with mpmath.workdps(DIGITS):
        size = abs(truth)
        return float(abs(mpmath.mpf(float(found)) - truth) / (size if size else 1))


def largest_relative_error(found: Iterable[float], truth: Iterable[Any]) -> float:
    """Largest relative error of several numbers, each against its own truth."""
    return max(relative_error(one, other) for one, other in zip(found, truth, strict=True))


def polygon_area(corners: NDArray[np.float64]) -> Any:  # an mpmath number
    """Area of a counterclockwise polygon (q, 2)."""
    with mpmath.workdps(DIGITS):
        points = [(mpmath.mpf(float(x)), mpmath.mpf(float(y))) for x, y in corners]
        following = points[1:] + points[:1]
        return (
            sum((x0 * y1 - y0 * x1 for (x0, y0), (x1, y1) in zip(points, following, strict=True)), mpmath.mpf(0)) / 2
        )


def circle_overlap(corners: NDArray[np.float64], centre: Sequence[float], radius: float) -> Any:
    """Area of a counterclockwise polygon (q, 2) inside a circle, by Green's theorem along its sides."""
    with mpmath.workdps(DIGITS):
        middle = mpmath.mpc(float(centre[0]), float(centre[1]))
        points = [mpmath.mpc(float(x), float(y)) - middle for x, y in corners]
        r = mpmath.mpf(float(radius))
        following = points[1:] + points[:1]
        return sum((_under_side(a, b, r) for a, b in zip(points, following, strict=True)), mpmath.mpf(0))


def _under_side(start: Any, end: Any, radius: Any) -> Any:
    """Signed area between the origin and a directed side, as far as it is inside a circle about the origin."""
    along = end - start
    length2 = abs(along) ** 2
    middle = -mpmath.re(start * mpmath.conj(along)) / length2
    under = radius**2 - mpmath.im(mpmath.conj(start) * along) ** 2 / length2
    half = mpmath.sqrt(under / length2) if under > 0 else mpmath.mpf(0)
    first, last = (min(max(one, mpmath.mpf(0)), mpmath.mpf(1)) for one in (middle - half, middle + half))
    enters, leaves = start + first * along, start + last * along
    turned = _angle(start, enters) if first > 0 else mpmath.mpf(0)
    turned += _angle(leaves, end) if last < 1 else mpmath.mpf(0)
    return (radius**2 * turned + mpmath.im(mpmath.conj(enters) * leaves)) / 2


def _angle(one: Any, other: Any) -> Any:
    return mpmath.arg(mpmath.conj(one) * other)
