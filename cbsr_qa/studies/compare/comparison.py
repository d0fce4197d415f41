"""A whole comparison: groups, every metric of them with its p values adjusted for all, and what to keep in mind.

Which group the others are compared with: one with which something can be compared.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from difflib import get_close_matches

import numpy as np

from cbsr_qa.domain import RefusedError
from cbsr_qa.domain.results import FleetTable
from cbsr_qa.stats import benjamini_hochberg, holm
from cbsr_qa.studies.compare.cautions import cautions
from cbsr_qa.studies.compare.describe import Group, groups_of
from cbsr_qa.studies.compare.design import Design, design_of
from cbsr_qa.studies.compare.figures import BoolArray, MetricFigures, figures_of, named
from cbsr_qa.studies.compare.groups import Grouping, grouped, reference_rank
from cbsr_qa.studies.compare.metric import MetricComparison, metric_comparison
from cbsr_qa.studies.compare.terms import Adjustment, By, Terms


def referred_to(grouping: Grouping, design: Design, measured: BoolArray, terms: Terms) -> tuple[Grouping, list[str]]:
    """Put a group first that most others can be compared with, unless groups were named; and say so.

    Parameters
    ----------
    measured : (R,) whether a run has a value of anything.

    Returns
    -------
    Groups, the reference first, and what is to be said of the choice, in sentences.
    """
    part_of = _parts(grouping, design, measured)
    sizes = Counter(part_of.values())
    first = grouping.reference
    best = min(
        grouping.names,
        key=lambda name: (-sizes[part_of[name]], *reference_rank(name, len(grouping.tests[name]), terms.by)),
    )
    if sizes[part_of[best]] < 2 or sizes[part_of[best]] <= sizes[part_of[first]]:
        return grouping, []
    members = [name for name in grouping.names if part_of[name] == part_of[best]]
    if terms.groups:
        if sizes[part_of[first]] > 1:
            return grouping, []
        said = f"Nothing can be compared with {first}; {named(members)} can among themselves"
        return grouping, [f"{said}: --groups {','.join(members)}"]
    usual = "is the earliest" if terms.by is By.PERIOD else "has most sensors"
    said = f"The reference is {best}: {first} {usual}, and cannot be compared with {named(members)}"
    return replace(grouping, names=(best, *(name for name in sorted(grouping.names) if name != best))), [said]


def _parts(grouping: Grouping, design: Design, measured: BoolArray) -> dict[str, int]:
    """Group → the connected part it is in; one without a value is a part of its own."""
    alone = {name: -1 - place for place, name in enumerate(grouping.names)}
    known = measured[design.rows]
    if not known.any():
        return alone
    made = design.crossing.only(known)
    names, parts = (made.stations, made.station_parts) if design.of_stations else (made.groups, made.group_parts)
    return alone | dict(zip(names, parts.tolist(), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """What was compared, and what came of it."""

    terms: Terms
    groups: tuple[Group, ...]
    metrics: tuple[MetricComparison, ...]
    warnings: tuple[str, ...]
    simulated: tuple[str, ...]
    recipes: tuple[str, ...]

    @property
    def reference(self) -> str:
        """The group the others are compared with."""
        return self.groups[0].name

    @property
    def compared(self) -> bool:
        """Whether any difference could be told."""
        return any(one.value is not None for metric in self.metrics for one in metric.differences)


def compare(table: FleetTable, terms: Terms, now: datetime) -> Comparison:
    """Compare groups of runs in every metric.

    Parameters
    ----------
    table : runs and their values.
    now : by the computer's clock, for times that are still to come.

    Raises
    ------
    RefusedError
        If no run counts, or a group or metric that was named is not there (with the nearest name).
    """
    grouping = grouped(table.runs, terms)
    every = list(figures_of(table, grouping.used))
    chosen = _wanted(every, terms)
    design = design_of(table.runs, grouping, terms.by)
    grouping, referred = referred_to(grouping, design, _measured(every, len(table.runs)), terms)
    deciding = grouping.deciding(table.runs, terms.policy)
    metrics = [metric_comparison(figures, table, grouping, deciding, design, terms) for figures in chosen]
    members = [run for run, used in zip(table.runs, grouping.used, strict=True) if used]
    return Comparison(
        terms=terms,
        groups=tuple(groups_of(table.runs, grouping, every, terms)),
        metrics=tuple(_adjusted(metrics, terms.adjustment)),
        warnings=(*referred, *cautions(members, grouping, design, terms, now)),
        simulated=tuple(sorted({said for simulated in {run.simulated for run in members} for said in simulated})),
        recipes=tuple(sorted({run.recipe for run in members})),
    )


def _measured(every: Sequence[MetricFigures], runs: int) -> BoolArray:
    """(R,) whether a run has a value of anything."""
    measured: BoolArray = np.zeros(runs, dtype=np.bool_)
    for figures in every:
        measured |= ~np.isnan(figures.mean)
    return measured


def _wanted(every: Sequence[MetricFigures], terms: Terms) -> list[MetricFigures]:
    known = sorted({figures.key.name for figures in every})
    for name in (*terms.names, *terms.margins, *terms.detect):
        if name not in known:
            raise unknown_metric(name, known)
    for option, asked in (("--margin", terms.margins), ("--detect", terms.detect)):
        for name in asked if terms.names else ():
            if name not in terms.names:
                raise RefusedError(
                    f"{option} states {name!r}, which is not among the metrics to compare: {', '.join(terms.names)}",
                    remedy=f"name it too (--metric {name}), or leave its {option} out",
                )
    return [figures for figures in every if not terms.names or figures.key.name in terms.names]


def unknown_metric(name: str, known: Sequence[str]) -> RefusedError:
    """Refuse a metric nobody measured, with the nearest name."""
    near = get_close_matches(name, known, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return RefusedError(
        f"no run that counts measured {name[:64]!r}", remedy=f"{hint}measured: {', '.join(known) or 'nothing'}"
    )


def _adjusted(metrics: Sequence[MetricComparison], adjustment: Adjustment) -> list[MetricComparison]:
    """Adjust p values: those of groups for all of groups, and so those of likeness and those of stations."""
    every = [one for metric in metrics for one in metric.differences]
    groups = iter(_adjust([one.p_value for one in every], adjustment))
    alike = iter(_adjust([one.equivalence.p_value if one.equivalence else None for one in every], adjustment))
    stations = iter(_adjust([one.p_value for metric in metrics for one in metric.stations], adjustment))
    return [
        replace(
            metric,
            differences=tuple(
                replace(one, p_adjusted=next(groups), equivalence_p=next(alike)) for one in metric.differences
            ),
            stations=tuple(replace(one, p_adjusted=next(stations)) for one in metric.stations),
        )
        for metric in metrics
    ]


def _adjust(p_values: Sequence[float | None], adjustment: Adjustment) -> list[float | None]:
    made = [p for p in p_values if p is not None]
    method = {Adjustment.HOLM: holm, Adjustment.BENJAMINI_HOCHBERG: benjamini_hochberg}.get(adjustment)
    adjusted = iter(made if method is None else method(made).tolist())
    return [None if p is None else float(next(adjusted)) for p in p_values]
