"""The recommended setting: chosen on the sensors of a sweep, confirmed on new ones."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Final

from pydantic import Field

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.report.tables import plural
from cbsr_qa.studies.frontier.point import Accuracy, Knob, Point
from cbsr_qa.studies.frontier.setting import Setting

#: Longest time, and largest ratio of errors to those of the paper's campaign, if no target is given.
USUAL_BUDGET_S: Final = 25 * 60.0
USUAL_ROOM: Final = 1.2
#: Confidence with which an error must be below its target, on the sensors of the sweep and again on new ones. With
#: both, at most one choice in ten misses the target if errors scatter among sensors by up to 60 %.
CONFIDENCE: Final = 0.9
#: Largest number of settings that are tried on new sensors.
_ATTEMPTS: Final = 3
_FORCE: Final = "force_error"

#: Settings with their points.
TriedSettings = Sequence[tuple[Setting, Point]]
#: Function that tries a setting on new sensors.
Confirm = Callable[[Setting], Point]


@dataclass(frozen=True, slots=True)
class Target:
    """Force error [N] and station time [s], at most."""

    force_error_N: float | None = None
    budget_s: float | None = None


@dataclass(frozen=True, slots=True)
class Needed:
    """Presses that a target needs beyond those tried, with limits of 95 % confidence.

    Parameters
    ----------
    presses : best estimate; None if it is not known.
    low, high : limits; ``high`` is None if it is not known, ``low`` if no number of presses reaches the target.
    reachable : True if both limits are known, None if only the lower one is, False if the target cannot be reached.
    """

    presses: int | None
    low: int | None
    high: int | None
    reachable: bool | None


@dataclass(frozen=True, slots=True)
class Recommendation:
    """The recommended setting (or None), the reason, and the file of its recipe.

    Parameters
    ----------
    accuracy : on new sensors, which had no part in the choice; after a quick sweep on its only sensor.
    needed : presses for a target beyond those tried; None without one, or if their errors tell nothing.
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


def recommend(tried: TriedSettings, target: Target, *, paper: Point | None, confirm: Confirm) -> Recommendation:
    """Choose a setting on the sensors of a sweep, and confirm it on new ones.

    With a target accuracy, the fastest setting whose mean force error is below it with a confidence of 90 %, on the
    sensors of the sweep and again on new ones. With a budget alone, the smallest mean force error within it. Without
    either, that within 25 minutes, compared with the paper's campaign on the same sensors if that was tried. One
    sensor does not show how sensors scatter: no accuracy follows from it, and nothing is confirmed.

    RefusedError if no tried setting meets the target; names the nearest.
    """
    usable = [way for way in tried if _FORCE in way[1].accuracy and way[1].station_s is not None]
    if not usable:
        raise RefusedError("no setting that was tried has a force error", remedy="run the sweep without --quick")
    force_N = target.force_error_N
    budget_s = USUAL_BUDGET_S if target == Target() else target.budget_s
    affordable = [way for way in usable if budget_s is None or _seconds(way) <= budget_s]
    if not affordable:
        raise _refuse_all(usable, f"takes at most {(budget_s or 0.0) / 60:g} min")
    within = "" if budget_s is None else f" within {budget_s / 60:g} min"
    if min(point.seeds for _, point in affordable) < 2:
        return _choose_on_one_sensor(affordable, force_N, within)
    if force_N is not None:
        return _choose_fastest(affordable, force_N, within, confirm)
    return _choose_most_accurate(affordable, within, paper if target == Target() else None, confirm)


def _choose_on_one_sensor(affordable: TriedSettings, force_N: float | None, within: str) -> Recommendation:
    if force_N is not None:
        raise RefusedError(
            f"one simulated sensor does not show how sensors scatter, and so no setting to be below {force_N:g} N",
            remedy="run the sweep without --quick",
        )
    setting, point = min(affordable, key=_force_N)
    which = _describe_rank("the smallest force error", affordable, within)
    why = f"{which}, on one simulated sensor; on others another setting may be better"
    return Recommendation.from_point(point, f"{why}: decide by the sweep without --quick", setting)


def _choose_fastest(affordable: TriedSettings, force_N: float, within: str, confirm: Confirm) -> Recommendation:
    """Return the fastest setting that is below a force error on the sensors of the sweep, and on new ones."""
    limit = f"a mean force error below {force_N:g} N with {100 * CONFIDENCE:g} % confidence"
    sufficient = sorted((way for way in affordable if _is_below(way[1], force_N)), key=_seconds)
    if not sufficient:
        raise _refuse_all(affordable, f"has {limit}")
    for setting, point in sufficient[:_ATTEMPTS]:
        confirmed = confirm(setting)
        if _is_below(confirmed, force_N):
            sensors = f"on {point.seeds} sensors and again on {confirmed.seeds} new ones"
            which = _describe_rank("the fastest", affordable, within)
            return Recommendation.from_point(confirmed, f"{which} with {limit}, {sensors}", setting)
    raise _refuse_all(
        affordable, f"has {limit} on new sensors too; the fastest {len(sufficient[:_ATTEMPTS])} were tried"
    )


def _choose_most_accurate(
    affordable: TriedSettings, within: str, paper: Point | None, confirm: Confirm
) -> Recommendation:
    """Return the setting with the smallest mean force error that no new sensor refuses."""
    by_error = sorted(affordable, key=_force_N)[:_ATTEMPTS]
    confirmed_points = ((setting, point, confirm(setting)) for setting, point in by_error)
    learned = next((way for way in confirmed_points if _FORCE in way[2].accuracy), None)
    if learned is None:
        raise _refuse_all(affordable, f"can be learned on all new sensors; the most accurate {_ATTEMPTS} were tried")
    setting, point, confirmed = learned
    force = point.accuracy[_FORCE]
    rivals = [way for way in affordable if way[0] != setting and not _is_below_zero(force.subtract(_force(way)))]
    which = _describe_rank("the smallest mean force error", affordable, within)
    why = f"{which} on {point.seeds} sensors; the error stated is that of {confirmed.seeds} new ones"
    if rivals:
        why += f"; {plural(len(rivals), 'other')} cannot be distinguished from it"
    if paper is not None and _FORCE in paper.accuracy:
        why += f"; {_compare(force, paper.accuracy[_FORCE])}"
    return Recommendation.from_point(confirmed, why, setting)


def _describe_rank(superlative: str, affordable: TriedSettings, within: str) -> str:
    """Say how a setting stands among those that can be afforded."""
    if len(affordable) == 1:
        return f"the only setting{within} that was tried"
    return f"{superlative} of {len(affordable)} settings{within}"


def _compare(force: Accuracy, paper: Accuracy) -> str:
    """Say the ratio to the paper's campaign, of pairs of the same sensors."""
    ratio = force.value / paper.value
    stderr = (force.subtract(paper, ratio).stderr or 0.0) / paper.value
    if _is_below_zero(force.subtract(paper, USUAL_ROOM)):
        verdict = "within"
    else:
        verdict = "not within" if _is_below_zero(paper.subtract(force, 1 / USUAL_ROOM)) else "not surely within"
    words = f"{ratio:.2f} ± {stderr:.2f} times that of the paper's campaign on the same sensors"
    return f"{words}, {verdict} the {USUAL_ROOM:g} asked for"


def _refuse_all(ways: TriedSettings, verb: str) -> RefusedError:
    best, quickest = min(ways, key=_force_N), min(ways, key=_seconds)
    return RefusedError(
        f"no setting of {len(ways)} {verb}",
        remedy=f"the most accurate has {_describe_setting(best)}, the quickest {_describe_setting(quickest)}",
    )


def _describe_setting(way: tuple[Setting, Point]) -> str:
    spread = "" if _force(way).stderr is None else f" ± {_force(way).stderr:.3f}"
    return f"{_force_N(way):.3f}{spread} N in {_seconds(way) / 60:.0f} min"


def _is_below(point: Point, force_N: float) -> bool:
    """Whether a point's force error is below a value with the confidence asked for."""
    bound = point.accuracy[_FORCE].upper_bound(CONFIDENCE) if _FORCE in point.accuracy else None
    return bound is not None and bound <= force_N


def _is_below_zero(difference: Accuracy) -> bool:
    bound = difference.upper_bound(CONFIDENCE)
    return bound is not None and bound < 0


def _seconds(way: tuple[Setting, Point]) -> float:
    return way[1].station_s or 0.0


def _force(way: tuple[Setting, Point]) -> Accuracy:
    return way[1].accuracy[_FORCE]


def _force_N(way: tuple[Setting, Point]) -> float:
    return _force(way).value
