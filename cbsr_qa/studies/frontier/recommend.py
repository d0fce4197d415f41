"""Settings worth their time, and the recommended one."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Final

from pydantic import Field

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.report.tables import plural
from cbsr_qa.studies.frontier.point import Accuracy, Knob, Point
from cbsr_qa.studies.frontier.setting import Setting


def mark_worth(
    points: Sequence[Point],
    cost: Callable[[Point], float | None],
    names: Sequence[str] = (),
    *,
    across_series: bool = False,
) -> list[Point]:
    """Mark for each point whether its accuracy is worth its cost, beyond chance.

    The rule: a setting is dominated where a *kept* setting

    - is cheaper and in no accuracy worse by more than their joint standard error √(s₁² + s₂²), or
    - costs as much and is in no accuracy worse and in one better, numbers taken as exact.

    Among settings of the same cost, differences within their errors do not count. A setting is not dominated by one
    that lacks any of its accuracies. Standard errors that are None count as zero.

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
    for price, accuracy, index in sorted(priced, key=_possibly_dominating):
        rivals = [rival for rival in front if across_series or points[rival[2]].series == points[index].series]
        if not any(_dominates(accuracy, price > other_price, other) for other_price, other, _ in rivals):
            front.append((price, accuracy, index))
    worthwhile = {index for _, _, index in front}
    return [replace(point, pareto=index in worthwhile) for index, point in enumerate(points)]


def joint_stderr(one: Accuracy, other: Accuracy) -> float:
    """Standard error of the difference of two values from different random numbers."""
    return math.hypot(one.stderr or 0.0, other.stderr or 0.0)


def _possibly_dominating(
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
            other_accuracy.shortfall <= accuracy.shortfall + joint_stderr(accuracy, other_accuracy)
            for accuracy, other_accuracy in pairs
        )
    differences = [other_accuracy.shortfall - accuracy.shortfall for accuracy, other_accuracy in pairs]
    return max(differences, default=0.0) <= 0 and any(differences)


#: Longest time, and largest ratio of errors to those of the paper's campaign, if no target is given.
USUAL_BUDGET_S: Final = 25 * 60.0
USUAL_ROOM: Final = 1.2
_FORCE: Final = "force_error"


@dataclass(frozen=True, slots=True)
class Target:
    """Force error [N] and station time [s], at most."""

    force_error_N: float | None = None
    budget_s: float | None = None


@dataclass(frozen=True, slots=True)
class Needed:
    """Presses needed by extrapolation, and the numbers one standard error below and above."""

    presses: int
    low: int
    high: int


@dataclass(frozen=True, slots=True)
class Recommendation:
    """The recommended setting (or None), the reason, and the file of its recipe.

    Parameters
    ----------
    needed : presses for a target beyond those tried; None unless their errors can be extrapolated to it.
    way, seeds : the setting of the station, and the number of its sensors; not in documents.
    """

    setting: Mapping[str, Knob] | None
    accuracy: Mapping[str, Accuracy] | None
    station_s: float | None
    why: str
    recipe: str | None = None
    needed: Needed | None = None
    way: Annotated[Setting | None, Field(exclude=True)] = None
    seeds: Annotated[int, Field(exclude=True)] = 0

    @classmethod
    def from_point(cls, point: Point, why: str, way: Setting | None = None) -> "Recommendation":
        return cls(point.knobs, point.accuracy, point.station_s, why, way=way, seeds=point.seeds)


def recommend(tried: Sequence[tuple[Setting, Point]], target: Target, *, paper: Point | None) -> Recommendation:
    """Choose a setting.

    With a target accuracy, the cheapest setting whose force error plus its standard error meets it. With a budget
    alone, the most accurate within it. Without either, the most accurate within 25 minutes, which must come within 20
    % of the paper's campaign if that was tried.

    RefusedError if no tried setting meets the target; names the nearest.
    """
    usable_settings = [way for way in tried if _FORCE in way[1].accuracy and way[1].station_s is not None]
    no_target, force_N = target == Target(), target.force_error_N
    budget_s = USUAL_BUDGET_S if no_target else target.budget_s
    affordable = [way for way in usable_settings if budget_s is None or _seconds(way) <= budget_s]
    sufficient = [way for way in affordable if force_N is None or _upper_N(way) <= force_N]
    if not sufficient:
        raise _none(usable_settings, force_N, budget_s)
    candidates = plural(len(affordable), "setting") + ("" if budget_s is None else f" within {budget_s / 60:g} min")
    if force_N is not None:
        setting, point = min(sufficient, key=_seconds)
        why = f"the fastest of {candidates} whose force error, with its standard error, is at most {force_N:g} N"
        return Recommendation.from_point(point, why, setting)
    setting, point = min(sufficient, key=_upper_N)
    why = f"the most accurate of {candidates}"
    if no_target and paper is not None and _FORCE in paper.accuracy:
        ratio = point.accuracy[_FORCE].value / paper.accuracy[_FORCE].value
        verdict = "within" if ratio <= USUAL_ROOM else "not within"
        why += (
            f"; its force error is {ratio:.2f} times that of the paper's campaign,"
            f" {verdict} the {USUAL_ROOM:g} asked for"
        )
    return Recommendation.from_point(point, why, setting)


def _none(usable: Sequence[tuple[Setting, Point]], force_N: float | None, budget_s: float | None) -> RefusedError:
    if not usable:
        return RefusedError("no setting that was tried has a force error", remedy="run the sweep without --quick")
    force = "" if force_N is None else f"has a force error, with its standard error, of at most {force_N:g} N"
    time = "" if budget_s is None else f"at most {budget_s / 60:g} min"
    target = f"{force} in {time}" if force and time else force or f"takes {time}"
    best, quickest = min(usable, key=_upper_N), min(usable, key=_seconds)
    return RefusedError(
        f"no setting of {len(usable)} {target}",
        remedy=f"the most accurate has {_describe_setting(best)}, the quickest {_describe_setting(quickest)}",
    )


def _describe_setting(way: tuple[Setting, Point]) -> str:
    force = way[1].accuracy[_FORCE]
    spread = "" if force.stderr is None else f" ± {force.stderr:.3f}"
    return f"{force.value:.3f}{spread} N in {_seconds(way) / 60:.0f} min"


def _seconds(way: tuple[Setting, Point]) -> float:
    return way[1].station_s or 0.0


def _upper_N(way: tuple[Setting, Point]) -> float:
    return way[1].accuracy[_FORCE].upper
