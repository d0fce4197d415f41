"""Control charts of a metric's values over runs, by settings: points, limits, signals, and what they stand for.

One metric's control charts: limits from a reference, the runs it rests on, and those since.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cbsr_qa.domain import NumericsError
from cbsr_qa.domain.results import RunLine
from cbsr_qa.domain.run import ChartKind, ChartReference, ChartSettings, StandingSignal
from cbsr_qa.report import plural
from cbsr_qa.stats import (
    SUM,
    Chart,
    Reference,
    Rule,
    Standard,
    cusum,
    ewma,
    individuals,
    means_and_ranges,
    moving_range,
)
from cbsr_qa.studies.figure_series import Series, named

#: Points without a signal after which one does not stand any more: what lasts signals again and again, and false
#: alarms are shown no longer than need be.
STANDS: Final = 5
#: Signals no further apart belong together: the longest pattern of Nelson's tests.
JOINED: Final = 15
#: Drawn, and not counted: one value far off moves it twice, and of undisturbed runs it is wrong in 1 of 110.
UNCOUNTED: Final = "moving range"
#: Rules by the numbers they are known by.
RULES: Final = {int(rule.value.partition(":")[0]): rule for rule in Rule}


@dataclass(frozen=True, slots=True, eq=False)
class Charted:
    """A chart, and which value is the last of each of its points.

    Parameters
    ----------
    ends : (points,) index of a value.
    """

    chart: Chart
    ends: tuple[int, ...]


def charts_of(values: Sequence[float], settings: ChartSettings, reference: Reference) -> tuple[Charted, ...]:
    """Return the charts of values: one, or two that go together.

    Parameters
    ----------
    values : in the order of runs; of means and ranges an incomplete last group is left out.
    reference : as of :mod:`cbsr_qa.stats.control_charts`.

    Raises
    ------
    NumericsError
        Too few values, or none that differ where limits are to come of them.
    """
    count = len(values)
    single = tuple(range(count))
    rules = [RULES[number] for number in settings.rules]
    match settings.kind:
        case ChartKind.INDIVIDUALS:
            first = Charted(individuals(values, reference=reference, rules=rules), single)
            if count < 2:
                return (first,)
            return first, Charted(moving_range(values, reference=reference), single[1:])
        case ChartKind.MEANS:
            size = settings.subgroup
            groups = [values[begin : begin + size] for begin in range(0, count - size + 1, size)]
            ends = tuple(range(size - 1, len(groups) * size, size))
            if not groups:
                raise NumericsError(f"{count} values make no group of {size}")
            return tuple(Charted(one, ends) for one in means_and_ranges(groups, reference=reference, rules=rules))
        case ChartKind.EWMA:
            return (Charted(ewma(values, weight=settings.weight, width=settings.width, reference=reference), single),)
        case ChartKind.CUSUM:
            both = cusum(values, slack=settings.slack, threshold=settings.threshold, reference=reference)
            return tuple(Charted(one, single) for one in both)


def standard_of(values: Sequence[float], settings: ChartSettings) -> Standard:
    """Return mean and short-term deviation of a reference period.

    Raises
    ------
    NumericsError
        Too few values, or none that differ.
    """
    first = charts_of(values, settings, None)[0].chart
    centre = first.centre
    if settings.kind is ChartKind.CUSUM:
        centre = individuals(values).centre  # a sum's own centre is zero
    return Standard(centre, first.deviation)


def standing(
    charts: Sequence[Charted], lines: Sequence[RunLine], reference: ChartReference, *, cut: bool
) -> StandingSignal | None:
    """Return the signal that stands at the last run; None where there is none.

    A signal stands until so many points in a row gave none (:data:`STANDS`); it began with the first that is joined
    to the latest by others, none further apart than :data:`JOINED`.

    Parameters
    ----------
    charts : of the values of ``lines``.
    cut : whether there were earlier runs that were not looked at.
    """
    found = [_standing(one) for one in charts if one.chart.name != UNCOUNTED]
    begun = [(points[0], rules) for points, rules in found if points]
    if not begun:
        return None
    begin = min(point for point, _ in begun)
    rules = tuple(dict.fromkeys(rule for _, own in sorted(begun, key=lambda one: one[0]) for rule in own))
    first = lines[begin]
    size = reference.settings.subgroup
    began = _sum_began(charts, begin)
    at_least = cut and (begin < JOINED * size or began == 0)
    grew = None if began is None else lines[began]
    return StandingSignal(
        reference,
        rules,
        first.run,
        first.started_at,
        len(lines) - begin,
        at_least,
        began_run="" if grew is None else grew.run,
        began=None if grew is None else grew.started_at,
    )


def _sum_began(charts: Sequence[Charted], begin: int) -> int | None:
    """Value after the last at which the sum that signals at ``begin`` was zero; None where no sum does.

    It is the usual estimate of when a shift began (Montgomery 9.1.2): the sum grows from then on.
    """
    for one in charts:
        chart = one.chart
        if chart.name.startswith(SUM) and any(signal.index == begin for signal in chart.signals):
            zeros = np.flatnonzero(chart.points[:begin] == 0.0)
            return int(zeros[-1]) + 1 if len(zeros) else 0
    return None


def _standing(one: Charted) -> tuple[list[int], tuple[str, ...]]:
    """Values at which the standing signal spoke, earliest first, and by which rules."""
    chart, last = one.chart, len(one.chart.points) - 1
    points: list[int] = []
    for signal in reversed(chart.signals):
        far = points[-1] - signal.index > JOINED if points else last - signal.index >= STANDS
        if far:
            break
        points.append(signal.index)
    if not points:
        return [], ()
    first = points[-1]
    of = f"{chart.name}, " if chart.name not in ("individuals", "means") else ""
    rules = dict.fromkeys(f"{of}{signal.rule}" for signal in chart.signals if signal.index >= first)
    return [one.ends[index] for index in reversed(points)], tuple(rules)


#: Below this many runs it is said how wide limits may be off.
FEW_RUNS: Final = 25


@dataclass(frozen=True, slots=True, eq=False)
class MetricChart:
    """One metric's charts.

    Parameters
    ----------
    reference : what its limits rest on; None where ``why`` says why there are none.
    lines, values : from the reference's first run on.
    phase_1 : how many of them are the reference's.
    before, after : charts of the reference period and of the runs since, which have the same limits.
    signal : that stands at the latest run.
    """

    label: str
    unit: str
    reference: ChartReference | None
    lines: tuple[RunLine, ...]
    values: tuple[float, ...]
    phase_1: int
    before: tuple[Charted, ...]
    after: tuple[Charted, ...]
    signal: StandingSignal | None
    why: str
    notes: tuple[str, ...]

    def named_run(self, run: str) -> str:
        """Return a run's name with the day it began, where it is one of the chart's."""
        day = next((line.day for line in self.lines if line.run == run), None)
        return run if day is None else f"{run} of {day}"


def no_chart(series: Series, why: str) -> MetricChart:
    """Return what there is of a metric without limits, and why it has none."""
    return MetricChart(
        series.key.label, series.unit, None, series.lines, series.values, 0, (), (), None, why, series.notes
    )


def metric_chart(series: Series, reference: ChartReference) -> MetricChart:
    """Chart a metric against a reference; no charts where the runs are in another unit."""
    notes = list(series.notes)
    if series.unit != reference.unit:
        return replace(no_chart(series, f"runs are in {series.unit}, the reference in {reference.unit}"))
    count = sum(line.run <= reference.last_run for line in series.lines)
    standard = Standard(reference.mean, reference.deviation)
    before = _charts(series.values[:count], reference.settings, standard)
    after = _charts(series.values[count:], reference.settings, standard)
    if reference.runs < FEW_RUNS:
        notes.append(f"limits of {reference.runs} runs are uncertain: false alarms may be several times as many")
    doubtful = dict.fromkeys(signal.rule for one in before for signal in one.chart.signals)
    if doubtful:
        notes.append(
            f"the reference period gives signals itself, so that its limits are doubtful: {named(list(doubtful))}"
        )
    if count != reference.runs:
        notes.append(
            f"{count} of the {reference.runs} runs of the reference have a value now: some were analysed anew"
        )
    size = reference.settings.subgroup
    rest = (len(series.values) - count) % size
    if rest:
        notes.append(f"the latest {plural(rest, 'run')} make no whole group of {size} yet, and no point")
    signal = standing(after, series.lines[count:], reference, cut=False)
    return MetricChart(
        reference.label,
        series.unit,
        reference,
        series.lines,
        series.values,
        count,
        before,
        after,
        signal,
        "",
        tuple(notes),
    )


def _charts(values: Sequence[float], settings: ChartSettings, standard: Standard) -> tuple[Charted, ...]:
    return charts_of(values, settings, standard) if len(values) >= settings.subgroup else ()
