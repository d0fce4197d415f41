"""Groups of stored runs compared."""

from collections.abc import Mapping, Sequence
from datetime import date
from enum import StrEnum
from typing import Literal, TypeVar

from cbsr_qa.config.serials import read_parts
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.interface.result import Result
from cbsr_qa.studies.compare.comparison import Comparison, compare_groups
from cbsr_qa.studies.compare.report import compare_outcome
from cbsr_qa.studies.compare.terms import Adjustment, By, Period, Policy, Quarantine, Terms
from cbsr_qa.system.clock import RealClock

C = TypeVar("C", bound=StrEnum)


def compare(
    by: Literal["batch", "material", "station", "software", "period"],
    *,
    groups: Sequence[str] = (),
    metric: str | Sequence[str] = (),
    recipe: str | None = None,
    part: str | Sequence[str] = (),
    since: date | None = None,
    until: date | None = None,
    margin: Mapping[str, float] | None = None,
    detect: Mapping[str, float] | None = None,
    policy: Literal["first", "last", "any"] = "last",
    quarantine: Literal["apart", "failed"] = "apart",
    period: Literal["day", "week", "month", "year"] = "month",
    adjust: Literal["holm", "benjamini-hochberg", "none"] = "holm",
    database: str | None = None,
) -> Result[Comparison]:
    """Compare stored runs of groups in every metric, as ``cbsr-qa compare`` does with the same options.

    Parameters
    ----------
    groups : the reference first; empty for all.
    part : runs of sensors with this part, as ``sheet=LOT7/B``; with all of several.
    margin, detect : metric → difference in its unit.

    Raises
    ------
    CbsrError
        If an option has no such value, a name is of no stored run, or the database cannot be read.
    """
    terms = Terms(
        by=_choice(By, "by", by),
        groups=tuple(groups),
        names=(metric,) if isinstance(metric, str) else tuple(metric),
        policy=_choice(Policy, "policy", policy),
        quarantine=_choice(Quarantine, "quarantine", quarantine),
        period=_choice(Period, "period", period),
        adjustment=_choice(Adjustment, "adjust", adjust),
        margins=dict(margin or {}),
        detect=dict(detect or {}),
    )
    parts = read_parts((part,) if isinstance(part, str) else part)
    selection = RunSelection(recipe=recipe, since=since, until=until, parts=parts)
    comparison = compare_groups(selection, terms, database=database, now=RealClock().wall())
    return Result(compare_outcome(comparison))


def _choice(kind: type[C], name: str, value: str) -> C:
    try:
        return kind(value)
    except ValueError:
        raise RefusedError(f"{name} is {value!r}", remedy=f"give one of {', '.join(kind)}") from None
