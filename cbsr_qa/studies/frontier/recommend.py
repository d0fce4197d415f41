"""Settings worth their time, and the recommended one."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from cbsr_qa.domain import NumericsError, RefusedError
from cbsr_qa.report import plural
from cbsr_qa.studies.frontier.point import Accuracy, Point
from cbsr_qa.studies.frontier.setting import Setting


def undominated_within_errors(
    points: Sequence[Point], cost: Callable[[Point], float | None], names: Sequence[str] | None = None
) -> tuple[bool, ...]:
    """Return for each point whether its accuracy is worth its cost, beyond chance.

    The rule: a setting is dominated where a *kept* setting

    - is cheaper and in no accuracy worse by more than their joint standard error √(s₁² + s₂²), or
    - costs no more and is in no accuracy worse, one of the two strictly, numbers taken as exact.

    Among settings of the same cost, differences within their errors do not count. A setting is not dominated by one
    that lacks any of its accuracies. Standard errors that are None count as zero.

    Kept means not dominated itself: otherwise a series of settings, each as good as the next within its error, would
    be dropped down to the cheapest, though the last is far better than the first. Settings cannot dominate each other
    in a circle, since each step is cheaper, or as cheap and better; so the kept ones depend on the points alone,
    there is at least one, and leaving out a dominated setting changes nothing.

    Parameters
    ----------
    cost : of a point, finite.
    names : of the accuracies to compare; by default all of the points.

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
    """Standard error of the difference of two values from different random numbers."""
    return math.hypot(one.stderr or 0.0, other.stderr or 0.0)


def _costs(points: Sequence[Point], cost: Callable[[Point], float | None]) -> list[float]:
    costs = []
    for number, point in enumerate(points):
        price = cost(point)
        if price is None or not math.isfinite(price):
            raise NumericsError(
                f"setting {number} of {len(points)} costs {price}", remedy="compare only settings whose cost is known"
            )
        costs.append(price)
    return costs


def _chosen(point: Point, names: Sequence[str] | None) -> dict[str, Accuracy]:
    return {name: figure for name, figure in point.accuracy.items() if names is None or name in names}


def _rank(cost: float, stated: Mapping[str, Accuracy]) -> tuple[float, int, list[tuple[str, float]]]:
    """Sort key that puts possibly dominating points first: cheaper, more accuracies, smaller errors."""
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
    return all(a <= b for a, b in zip(mine, theirs, strict=True)) and mine != theirs


#: Without a wish: longest time, and largest ratio of errors to the paper's campaign.
USUAL_BUDGET_S: Final = 25 * 60.0
USUAL_ROOM: Final = 1.2
_FORCE: Final = "force_error"


@dataclass(frozen=True, slots=True)
class Wish:
    """Wished force error [N] and station time [s], at most."""

    force_error_N: float | None = None
    budget_s: float | None = None


@dataclass(frozen=True, slots=True)
class Recommended:
    """The recommended setting, the reason, and the numbers behind the choice."""

    setting: Setting
    point: Point
    why: str


def recommend(tried: Sequence[tuple[Setting, Point]], wish: Wish, *, paper: Point | None) -> Recommended:
    """Choose a setting.

    With a wished accuracy, the cheapest setting whose force error plus its standard error meets it. With a budget
    alone, the most accurate within it. Without either, the most accurate within 25 minutes, which must come within 20
    % of the paper's campaign if that was tried.

    RefusedError if no tried setting meets the wish; names the nearest.
    """
    usable = [
        (setting, point) for setting, point in tried if _FORCE in point.accuracy and point.station_s is not None
    ]
    if wish.force_error_N is None:
        return _most_accurate(usable, wish.budget_s or USUAL_BUDGET_S, None if wish.budget_s else paper)
    within = [way for way in usable if wish.budget_s is None or _seconds(way) <= wish.budget_s]
    enough = [way for way in within if _surely_N(way) <= wish.force_error_N]
    if not enough:
        raise _none(usable, wish)
    best = min(enough, key=_seconds)
    room = "" if wish.budget_s is None else f" within {wish.budget_s / 60:g} min"
    limit = f"force error, with its standard error, is at most {wish.force_error_N:g} N"
    return Recommended(*best, f"the fastest of {plural(len(within), 'setting')}{room} whose {limit}")


def _most_accurate(usable: Sequence[tuple[Setting, Point]], budget_s: float, paper: Point | None) -> Recommended:
    within = [way for way in usable if _seconds(way) <= budget_s]
    if not within:
        raise _none(usable, Wish(budget_s=budget_s))
    best = min(within, key=_surely_N)
    why = f"the most accurate of {plural(len(within), 'setting')} within {budget_s / 60:g} min"
    if paper is not None and _FORCE in paper.accuracy:
        share = best[1].accuracy[_FORCE].value / paper.accuracy[_FORCE].value
        met = "within" if share <= USUAL_ROOM else "not within"
        why += (
            f"; its force error is {share:.2f} times that of the paper's campaign, {met} the {USUAL_ROOM:g} asked for"
        )
    return Recommended(*best, why)


def _none(usable: Sequence[tuple[Setting, Point]], wish: Wish) -> RefusedError:
    if not usable:
        return RefusedError("no setting that was tried has a force error", remedy="run the sweep without --quick")
    time = f"at most {wish.budget_s / 60:g} min" if wish.budget_s is not None else ""
    wanted = f"takes {time}"
    if wish.force_error_N is not None:
        force = f"has a force error, with its standard error, of at most {wish.force_error_N:g} N"
        wanted = f"{force} in {time}" if time else force
    best, quickest = min(usable, key=_surely_N), min(usable, key=_seconds)
    return RefusedError(
        f"no setting of {len(usable)} {wanted}",
        remedy=f"the most accurate has {_described(best)}, the quickest {_described(quickest)}",
    )


def _described(way: tuple[Setting, Point]) -> str:
    force = way[1].accuracy[_FORCE]
    spread = "" if force.stderr is None else f" ± {force.stderr:.3f}"
    return f"{force.value:.3f}{spread} N in {_seconds(way) / 60:.0f} min"


def _seconds(way: tuple[Setting, Point]) -> float:
    assert way[1].station_s is not None
    return way[1].station_s


def _surely_N(way: tuple[Setting, Point]) -> float:
    """Force error plus its standard error, to allow for chance."""
    force = way[1].accuracy[_FORCE]
    return force.value + (force.stderr or 0.0)
