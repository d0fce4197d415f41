"""Control charts of a metric's values over runs, by settings: points, limits, signals, and what they stand for."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.run_figures import RunLine
from cbsr_qa.domain.station_charts import ChartKind, ChartReference, ChartSettings, StandingSignal
from cbsr_qa.stats.control_charts import (
    SUM,
    Chart,
    Reference,
    Standard,
    cusum,
    ewma,
    individuals,
    means_and_ranges,
    moving_range,
)
from cbsr_qa.stats.nelson import Rule

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
