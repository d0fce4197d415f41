"""The setting to take: the cheapest that is accurate enough, or the most accurate there is time for."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.frontier.point import Point
from cbsr_qa.frontier.setting import Setting

#: Without a wish: at most so long, and at most so much worse than the paper's campaign.
USUAL_BUDGET_S: Final = 25 * 60.0
USUAL_ROOM: Final = 1.2
_FORCE: Final = "force_error"


@dataclass(frozen=True, slots=True)
class Wish:
    """What somebody wants; both may be given.

    Parameters
    ----------
    force_error_N : at most.
    budget_s : at most.
    """

    force_error_N: float | None = None
    budget_s: float | None = None


@dataclass(frozen=True, slots=True)
class Recommended:
    """The setting to take.

    Parameters
    ----------
    why : in words, with the numbers it was chosen by.
    """

    setting: Setting
    point: Point
    why: str


def recommend(tried: Sequence[tuple[Setting, Point]], wish: Wish, *, paper: Point | None) -> Recommended:
    """Choose a setting.

    With a wished accuracy the cheapest setting whose force error, with its standard error added, meets it. With a
    budget alone the most accurate within it. Without either: within 25 minutes the most accurate, which must come
    within 20 % of the paper's campaign where that was tried.

    Raises
    ------
    RefusedError
        If no setting that was tried meets the wish; names the nearest.
    """
    usable = [
        (setting, point) for setting, point in tried if _FORCE in point.accuracy and point.station_s is not None
    ]
    if wish.force_error_N is None:
        return _most_accurate(usable, wish.budget_s or USUAL_BUDGET_S, None if wish.budget_s else paper)
    within = [one for one in usable if wish.budget_s is None or _seconds(one) <= wish.budget_s]
    enough = [one for one in within if _surely_N(one) <= wish.force_error_N]
    if not enough:
        raise _none(usable, wish)
    best = min(enough, key=_seconds)
    room = "" if wish.budget_s is None else f" that take at most {wish.budget_s / 60:g} min"
    why = f"the cheapest of {len(within)}{room} whose force error, with its standard error, is at most"
    return Recommended(*best, f"{why} {wish.force_error_N:g} N")


def _most_accurate(usable: Sequence[tuple[Setting, Point]], budget_s: float, paper: Point | None) -> Recommended:
    within = [one for one in usable if _seconds(one) <= budget_s]
    if not within:
        raise _none(usable, Wish(budget_s=budget_s))
    best = min(within, key=_surely_N)
    why = f"the most accurate of {len(within)} that take at most {budget_s / 60:g} min"
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
    asked = f"takes {time}"
    if wish.force_error_N is not None:
        force = f"has a force error, with its standard error, of at most {wish.force_error_N:g} N"
        asked = f"{force} in {time}" if time else force
    best, quickest = min(usable, key=_surely_N), min(usable, key=_seconds)
    return RefusedError(
        f"none of the {len(usable)} settings that were tried {asked}",
        remedy=f"the most accurate has {_said(best)}, the quickest {_said(quickest)}",
    )


def _said(one: tuple[Setting, Point]) -> str:
    force = one[1].accuracy[_FORCE]
    spread = "" if force.stderr is None else f" ± {force.stderr:.3f}"
    return f"{force.value:.3f}{spread} N in {_seconds(one) / 60:.0f} min"


def _seconds(one: tuple[Setting, Point]) -> float:
    assert one[1].station_s is not None
    return one[1].station_s


def _surely_N(one: tuple[Setting, Point]) -> float:
    """Force error with its standard error added: what luck may have made small counts less."""
    force = one[1].accuracy[_FORCE]
    return force.value + (force.stderr or 0.0)
