"""Groups of stored runs compared."""

from collections.abc import Mapping, Sequence
from datetime import date
from typing import Literal

from cbsr_qa.domain.results import RunSelection
from cbsr_qa.interface.result import Result
from cbsr_qa.studies.compare import (
    Adjustment,
    By,
    Comparison,
    Period,
    Policy,
    Quarantine,
    Terms,
    compare_groups,
    compare_outcome,
)
from cbsr_qa.system import RealClock


def compare(
    by: Literal["batch", "material", "station", "software", "period"],
    *,
    groups: Sequence[str] = (),
    metric: str | Sequence[str] = (),
    recipe: str | None = None,
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
    margin, detect : metric → difference in its unit.

    Raises
    ------
    CbsrError
        If a name is of no stored run, or the database cannot be read.
    """
    terms = Terms(
        by=By(by),
        groups=tuple(groups),
        names=(metric,) if isinstance(metric, str) else tuple(metric),
        policy=Policy(policy),
        quarantine=Quarantine(quarantine),
        period=Period(period),
        adjustment=Adjustment(adjust),
        margins=dict(margin or {}),
        detect=dict(detect or {}),
    )
    selection = RunSelection(recipe=recipe, since=since, until=until)
    comparison = compare_groups(selection, terms, database=database, now=RealClock().wall())
    return Result(compare_outcome(comparison))
