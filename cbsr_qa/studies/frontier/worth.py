"""Settings worth their cost."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from cbsr_qa.studies.frontier.point import Accuracy, Point


def mark_worth(
    points: Sequence[Point],
    cost: Callable[[Point], float | None],
    names: Sequence[str] = (),
    *,
    across_series: bool = False,
) -> list[Point]:
    """Mark for each point whether its accuracy is worth its cost, beyond chance.

    The rule: a setting is dominated where a *kept* setting

    - is cheaper and in no accuracy worse by more than the standard error of the difference, or
    - costs as much and is in no accuracy worse and in one better, numbers taken as exact.

    Among settings of the same cost, differences within their errors do not count. A setting is not dominated by one
    that lacks any of its accuracies. Differences are those of pairs where both settings were tried on the same
    sensors (:meth:`.point.Accuracy.subtract`). Standard errors that are None count as zero.

    A setting is kept if it is not dominated itself. Without this condition, a series of settings, each as good as the
    next within its error, would be dropped down to the cheapest, though the last is far better than the first.
    Settings cannot dominate each other in a circle, since each step is cheaper, or as cheap and better. The kept ones
    thus depend on the points alone, there is at least one, and leaving out a dominated setting changes nothing.

    Parameters
    ----------
    cost : function that returns the cost of a point; a point without a cost is not worth it.
    names : names of the accuracies to compare, by default all; a point that lacks one is not worth its cost.
    across_series : compare settings of different series, too.
    """
    priced = [
        (price, {name: point.accuracy[name] for name in names or point.accuracy}, index)
        for index, point in enumerate(points)
        if (price := cost(point)) is not None and point.accuracy.keys() >= set(names)
    ]
    front: list[tuple[float, Mapping[str, Accuracy], int]] = []
    for price, accuracy, index in sorted(priced, key=_rank_dominating):
        rivals = [rival for rival in front if across_series or points[rival[2]].series == points[index].series]
        if not any(_dominates(accuracy, price > other_price, other) for other_price, other, _ in rivals):
            front.append((price, accuracy, index))
    worthwhile = {index for _, _, index in front}
    return [replace(point, pareto=index in worthwhile) for index, point in enumerate(points)]


def _rank_dominating(
    way: tuple[float, Mapping[str, Accuracy], int],
) -> tuple[float, int, list[tuple[str, float]]]:
    """Sort key that puts possibly dominating settings first: cheaper, more accuracies, smaller errors."""
    price, accuracy, _ = way
    return price, -len(accuracy), sorted((name, value.shortfall) for name, value in accuracy.items())


def _dominates(stated: Mapping[str, Accuracy], dearer: bool, other: Mapping[str, Accuracy]) -> bool:
    """Whether a setting that costs as much as another, or is dearer, is dominated by that."""
    if not stated.keys() <= other.keys():
        return False
    pairs = [(value, other[name]) for name, value in stated.items()]
    if dearer:
        return all(
            other_accuracy.shortfall <= accuracy.shortfall + (accuracy.subtract(other_accuracy).stderr or 0.0)
            for accuracy, other_accuracy in pairs
        )
    differences = [other_accuracy.shortfall - accuracy.shortfall for accuracy, other_accuracy in pairs]
    return max(differences, default=0.0) <= 0 and any(differences)
