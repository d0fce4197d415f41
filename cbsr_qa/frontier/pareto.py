"""Which settings are worth their time: those that no other setting dominates."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.frontier.point import Accuracy, Point

P = TypeVar("P")


def undominated(
    points: Sequence[P], cost: Callable[[P], float | None], error: Callable[[P], Sequence[float]]
) -> tuple[bool, ...]:
    """Tell of every point whether no other dominates it, numbers taken as exact.

    A point is dominated by another that costs no more and has no larger error, one of the two strictly. Equal points
    do not dominate each other.

    Parameters
    ----------
    points : n of them.
    cost : of a point, finite.
    error : of a point: one number or several, as many for each point, less is better.

    Returns
    -------
    n truth values; at least one is true where n > 0.

    Raises
    ------
    NumericsError
        If a point has no cost, a number is not finite, or points have different numbers of errors.
    """
    costs, errors = _costs(points, cost), [tuple(error(point)) for point in points]
    if len({len(one) for one in errors}) > 1 or not all(math.isfinite(value) for one in errors for value in one):
        raise NumericsError(
            "settings can be compared only where each has the same errors, as finite numbers",
            remedy="compare the settings of one series, without those that have no figure",
        )

    def dominates(one: int, other: int) -> bool:
        return _exactly((costs[one], *errors[one]), (costs[other], *errors[other]))

    return tuple(not any(dominates(one, other) for one in range(len(points))) for other in range(len(points)))


def undominated_within_errors(
    points: Sequence[Point], cost: Callable[[Point], float | None], names: Sequence[str] | None = None
) -> tuple[bool, ...]:
    """Tell of every point whether it buys accuracy that can be told from chance.

    The rule: a setting is dominated where a *kept* setting

    - is cheaper and in no accuracy worse by more than their joint standard error √(s₁² + s₂²), or
    - costs no more and is in no accuracy worse, one of the two strictly, numbers taken as exact.

    Among settings of the same cost differences within their errors are no reason to drop one. A setting of which
    another does not state an accuracy is not dominated by it. Standard errors that are None count as zero.

    Kept means not dominated itself: without that a row of settings, each as good as the next within its error, would
    be dropped up to the cheapest, though the last is far better than the first. No circle of settings can dominate
    each other, since each step is cheaper, or as cheap and better; which are kept is therefore determined by the
    points alone, at least one is, and to leave a dominated setting out changes nothing. A point that this rule keeps
    and :func:`undominated` does not may exist, and the other way round: the exact rule drops no setting for being
    only as good as a cheaper one within its errors.

    Parameters
    ----------
    cost : of a point, finite.
    names : of the accuracies to look at; by default all that the points state.

    Raises
    ------
    NumericsError
        If a point has no cost, or it is not finite.
    """
    costs = _costs(points, cost)
    stated = [_chosen(point, names) for point in points]
    kept: list[int] = []
    for index in sorted(range(len(points)), key=lambda at: _rank(costs[at], stated[at])):
        dominated = any(_dominates(costs[other], stated[other], costs[index], stated[index]) for other in kept)
        if not dominated:
            kept.append(index)
    chosen = set(kept)
    return tuple(index in chosen for index in range(len(points)))


def joint_stderr(one: Accuracy, other: Accuracy) -> float:
    """Standard error of the difference of two figures from different random numbers."""
    return math.hypot(one.stderr or 0.0, other.stderr or 0.0)


def _costs(points: Sequence[P], cost: Callable[[P], float | None]) -> list[float]:
    found = []
    for number, point in enumerate(points):
        price = cost(point)
        if price is None or not math.isfinite(price):
            raise NumericsError(
                f"setting {number} of {len(points)} costs {price}", remedy="compare only settings whose cost is known"
            )
        found.append(price)
    return found


def _chosen(point: Point, names: Sequence[str] | None) -> dict[str, Accuracy]:
    return {name: figure for name, figure in point.accuracy.items() if names is None or name in names}


def _rank(cost: float, stated: Mapping[str, Accuracy]) -> tuple[float, int, list[tuple[str, float]]]:
    """Sort key by which whoever may dominate comes first: cheaper, stating more, smaller errors."""
    return cost, -len(stated), sorted((name, figure.shortfall) for name, figure in stated.items())


def _dominates(cost: float, stated: Mapping[str, Accuracy], others: float, other: Mapping[str, Accuracy]) -> bool:
    if not other.keys() <= stated.keys():
        return False
    if cost < others:
        return all(
            stated[name].shortfall <= figure.shortfall + joint_stderr(stated[name], figure)
            for name, figure in other.items()
        )
    shared = sorted(other)
    mine, theirs = ((a, *(of[name].shortfall for name in shared)) for a, of in ((cost, stated), (others, other)))
    return _exactly(mine, theirs)


def _exactly(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    """Whether no number of one is larger and some number is smaller."""
    return all(a <= b for a, b in zip(one, other, strict=True)) and one != other
