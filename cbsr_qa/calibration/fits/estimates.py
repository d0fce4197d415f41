"""Numbers with their uncertainties: straight lines, ratios, and pooled scatter."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, finite_numbers

#: Fewest points of a characteristic: a straight line fits any two.
FEWEST_POINTS: Final = 3


#: Largest number of points that are searched by triples.
_MOST_POINTS: Final = 100


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its uncertainty.

    Parameters
    ----------
    stderr : one standard deviation, or None if unknown.
    degrees : degrees of freedom of the stated scatter.
    """

    value: float
    stderr: float | None
    degrees: int


@dataclass(frozen=True, slots=True, eq=False)
class StraightLine:
    """A straight line through a characteristic, and the deviations from it.

    Parameters
    ----------
    deviations : (n,) float64, points minus line, in the unit of y.
    largest : largest absolute deviation.
    stderr : standard error of ``largest``, with the deciding points held fixed: too large if several compete, never
        too small. None if the points' errors are unknown.
    """

    slope: float
    intercept: float
    deviations: Array
    largest: float
    stderr: float | None


def pool_deviations(cells: Sequence[Sequence[float]]) -> Estimate:
    """Standard deviation within cells, pooled: s² = Σ (n_c − 1) s_c² / Σ (n_c − 1) (ISO 5725-2, 7.4.5).

    NumericsError if no cell has two values, or a value is not finite.
    """
    repeated = [finite_numbers(cell, "values of a cell") for cell in cells if len(cell) > 1]
    degrees = sum(len(cell) - 1 for cell in repeated)
    if not degrees:
        raise NumericsError(
            "nothing was pressed twice at the same place and strain", remedy="give the recipe trials = 2 or more"
        )
    deviation = float(np.sqrt(sum(((cell - cell.mean()) ** 2).sum() for cell in repeated) / degrees))
    return Estimate(deviation, deviation / float(np.sqrt(2 * degrees)), degrees)


def best_straight_line(x: Sequence[float], y: Sequence[float], stderr: Sequence[float] | None = None) -> StraightLine:
    """Fit the line whose largest deviation is smallest: the best straight line of independent linearity (ISA-51.1).

    By Chebyshev's alternation theorem three points decide it: those whose own levelled deviation, ½ |y₂ − λ y₁ −
    (1 − λ) y₃| with λ = (x₃ − x₂)/(x₃ − x₁), is the largest of all triples. All triples are tried, so it is exact.

    NumericsError with fewer than 3 points or more than 100, lengths that differ, a number that is not finite, or x
    that coincide.

    Parameters
    ----------
    x, y : (n,) n ≥ 3 points, in any order.
    stderr : (n,) standard errors of y, or None if unknown.
    """
    place, value, error, order = _sort_points(x, y, stderr)
    triples = np.array(list(combinations(range(len(place)), 3)))
    first, middle, last = triples.T
    share = (place[last] - place[middle]) / (place[last] - place[first])
    half_deviations = (value[middle] - share * value[first] - (1 - share) * value[last]) / 2
    worst_triple = int(np.argmax(np.abs(half_deviations)))
    left_point, _, right_point = triples[worst_triple]
    slope = float((value[right_point] - value[left_point]) / (place[right_point] - place[left_point]))
    of_largest = _combine_errors(error, triples[worst_triple], float(share[worst_triple]), 0.5)
    return _line(
        slope,
        (place[left_point], value[left_point]),
        float(half_deviations[worst_triple]),
        place,
        value,
        order,
        of_largest,
    )


def terminal_line(x: Sequence[float], y: Sequence[float], stderr: Sequence[float] | None = None) -> StraightLine:
    """Draw the line through the first and the last point: terminal-based linearity (ISA-51.1).

    Parameters and errors are those of :func:`best_straight_line`.
    """
    place, value, error, order = _sort_points(x, y, stderr)
    slope = float((value[-1] - value[0]) / (place[-1] - place[0]))
    furthest = int(np.argmax(np.abs(value - value[0] - slope * (place - place[0]))))
    share = float((place[-1] - place[furthest]) / (place[-1] - place[0]))
    of_largest = _combine_errors(error, np.array([0, furthest, len(place) - 1]), share, 1.0)
    return _line(slope, (place[0], value[0]), 0.0, place, value, order, of_largest)


def ratio_of_sums(parts: Sequence[float], wholes: Sequence[float]) -> Estimate:
    """Σ parts / Σ wholes: a ratio over many loads in which each counts by its size.

    A mean of single ratios would be dominated by the weakest loads, whose ratio is mostly noise. The standard error
    is that of the ratio estimator, √(n/(n − 1) Σ (pᵢ − r wᵢ)²) / Σ wᵢ (Cochran 1977, 6.4); None for a single load.

    NumericsError if there is nothing, lengths differ, a number is not finite, or the wholes sum to zero.
    """
    part, whole = finite_numbers(parts, "parts"), finite_numbers(wholes, "wholes")
    if len(part) != len(whole):
        raise NumericsError(f"{len(part)} parts and {len(whole)} wholes do not fit together")
    total = float(whole.sum())
    if not total > 0:
        raise NumericsError(f"the changes under load sum to {total:.3g}: no share can be computed")
    ratio, count = float(part.sum()) / total, len(part)
    if count < 2:
        return Estimate(ratio, None, 0)
    scatter = float(np.sqrt(count / (count - 1) * ((part - ratio * whole) ** 2).sum()))
    return Estimate(ratio, scatter / total, count - 1)


def relative_spread(values: Sequence[float]) -> Estimate:
    """Standard deviation over mean; its standard error is that of normal values, c √((½ + c²)/(n − 1)).

    NumericsError with fewer than three values, a mean that is not positive, or a value that is not finite.
    """
    value = finite_numbers(values, "values of the locations")
    if len(value) < 3:
        raise NumericsError(f"a spread needs three locations; {len(value)} of them gave a value")
    mean = float(value.mean())
    if not mean > 0:
        raise NumericsError(f"the mean over the locations is {mean:.3g}, which nothing can be a share of")
    share, degrees = float(value.std(ddof=1)) / mean, len(value) - 1
    return Estimate(share, share * float(np.sqrt((0.5 + share**2) / degrees)), degrees)


def slope(x: Sequence[float], y: Sequence[float]) -> Estimate:
    """Slope of y against x by ordinary least squares with an intercept; two points give no error.

    NumericsError if all x coincide, or a number is not finite.
    """
    place, value = finite_numbers(x, "places of a slope"), finite_numbers(y, "values of a slope")
    centred = place - place.mean()
    square = float(centred @ centred)
    if not square > (1e-9 * float(np.abs(place).max(initial=1e-300))) ** 2 * len(place):
        raise NumericsError("a slope needs loads at two strains", remedy="press at clearly different strains")
    centred_values = value - value.mean()
    rate = float(centred @ centred_values) / square
    degrees = len(place) - 2
    if degrees < 1:
        return Estimate(rate, None, 0)
    residual = centred_values - rate * centred
    return Estimate(rate, float(np.sqrt(residual @ residual / degrees / square)), degrees)


def _sort_points(
    x: Sequence[float], y: Sequence[float], stderr: Sequence[float] | None
) -> tuple[Array, Array, Array | None, NDArray[np.intp]]:
    place, value = finite_numbers(x, "places of a characteristic"), finite_numbers(y, "its values")
    error = None if stderr is None else finite_numbers(stderr, "errors of a characteristic")
    if len(place) != len(value) or (error is not None and len(error) != len(place)):
        raise NumericsError("the points of a characteristic and their errors do not fit together")
    if not FEWEST_POINTS <= len(place) <= _MOST_POINTS:
        raise NumericsError(
            f"needs {FEWEST_POINTS} to {_MOST_POINTS} strains; there are {len(place)}",
            remedy=f"press at {FEWEST_POINTS} strains or more",
        )
    order = np.argsort(place, kind="stable")
    if (np.diff(place[order]) <= 1e-9 * np.abs(place).max()).any():
        raise NumericsError("two strains have the same stress")
    return place[order], value[order], None if error is None else error[order], order


def _combine_errors(error: Array | None, triple: NDArray[np.intp], share: float, factor: float) -> float | None:
    if error is None:
        return None
    weights = factor * np.array([share, 1.0, 1 - share])
    return float(np.sqrt(((weights * error[triple]) ** 2).sum()))


def _line(
    rate: float,
    point: tuple[float, float],
    above: float,
    place: Array,
    value: Array,
    order: NDArray[np.intp],
    stderr: float | None,
) -> StraightLine:
    """Return the line at a distance above a point; deviations are relative to it, not to a far intercept."""
    deviations = np.empty_like(value)
    deviations[order] = value - point[1] - rate * (place - point[0]) - above
    intercept = float(point[1] - rate * point[0] + above)
    return StraightLine(rate, intercept, deviations, float(np.abs(deviations).max()), stderr)
