"""Control charts of a metric's values over runs: points, limits, signals.

Limits come from a reference, i.e. from earlier runs; later runs are judged by them.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.results.charts import ChartKind, ChartReference, ChartSettings, StandingSignal
from cbsr_qa.domain.results.fleet import FleetTable, MetricKey, RunFigure, RunLine
from cbsr_qa.report.tables import list_names, number, plural
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
from cbsr_qa.stats.serial_correlation import FEWEST, correlate_successive, ewma_beyond, individuals_beyond
from cbsr_qa.studies.figure_series import Series, figures_of

#: Number of points without a signal after which a signal is over: lasting changes signal repeatedly, and false
#: alarms should not be shown longer than necessary.
STANDS: Final = 5
#: Longest gap between signals that belong together: the length of the longest of Nelson's patterns.
JOINED: Final = 15
#: Name of the chart that is drawn but not counted: one outlier moves it twice, and it signals in 1 of 110
#: undisturbed runs.
UNCOUNTED: Final = "moving range"
#: Nelson's rules by their numbers.
RULES: Final = dict(enumerate(Rule, start=1))


@dataclass(frozen=True, slots=True, eq=False)
class Charted:
    """A chart, and the index of the last value of each of its points (``ends``)."""

    chart: Chart
    ends: tuple[int, ...]


def charts_of(values: Sequence[float], settings: ChartSettings, reference: Reference) -> tuple[Charted, ...]:
    """Return the charts of values: one, or two that go together.

    Parameters
    ----------
    values : values in the order of runs; charts of means and ranges leave out an incomplete last group.
    reference : reference period or standard of :mod:`cbsr_qa.stats.control_charts`.

    Raises
    ------
    NumericsError
        Too few values, or equal values in the reference.
    """
    count = len(values)
    single_ends = tuple(range(count))
    rules = [RULES[number] for number in settings.rules]
    match settings.chart:
        case ChartKind.INDIVIDUALS:
            main_chart = Charted(individuals(values, reference=reference, rules=rules), single_ends)
            if count < 2:
                return (main_chart,)
            return main_chart, Charted(moving_range(values, reference=reference), single_ends[1:])
        case ChartKind.MEANS:
            size = settings.subgroup
            groups = [values[begin : begin + size] for begin in range(0, count - size + 1, size)]
            ends = tuple(range(size - 1, len(groups) * size, size))
            if not groups:
                raise NumericsError(f"{count} values make no group of {size}")
            return tuple(Charted(chart, ends) for chart in means_and_ranges(groups, reference=reference, rules=rules))
        case ChartKind.EWMA:
            return (
                Charted(ewma(values, weight=settings.weight, width=settings.width, reference=reference), single_ends),
            )
        case ChartKind.CUSUM:
            cusum_charts = cusum(values, slack=settings.slack, threshold=settings.threshold, reference=reference)
            return tuple(Charted(chart, single_ends) for chart in cusum_charts)


def standard_of(values: Sequence[float], settings: ChartSettings) -> Standard:
    """Return mean and short-term deviation of a reference period. NumericsError for too few or equal values."""
    main_chart = charts_of(values, settings, None)[0].chart
    centre = main_chart.centre
    if settings.chart is ChartKind.CUSUM:
        centre = individuals(values).centre  # a sum's own centre is zero
    return Standard(centre, main_chart.deviation)


def standing(
    charts: Sequence[Charted], lines: Sequence[RunLine], reference: ChartReference, *, cut: bool
) -> StandingSignal | None:
    """Return the signal that is active at the last run, or None; ``cut``: earlier runs were left out.

    A signal is active until :data:`STANDS` points in a row are without one; it began with the first signal connected
    to the latest by gaps of at most :data:`JOINED`.
    """
    signals = [_find_active(chart) for chart in charts if chart.chart.name != UNCOUNTED]
    active_signals = sorted(filter(None, signals), key=lambda signal: signal[0])
    if not active_signals:
        return None
    begin = active_signals[0][0]
    shift_begin = _sum_began(charts, begin)
    first_line, first_summed_line = lines[begin], None if shift_begin is None else lines[shift_begin]
    return StandingSignal(
        reference.label,
        tuple(dict.fromkeys(rule for _, chart_rules in active_signals for rule in chart_rules)),
        first_line.run,
        first_line.serial,
        first_line.started_at,
        len(lines) - begin,
        cut and (begin < JOINED * reference.subgroup or shift_begin == 0),
        *(
            ()
            if first_summed_line is None
            else (first_summed_line.run, first_summed_line.serial, first_summed_line.started_at)
        ),
    )


def _sum_began(charts: Sequence[Charted], begin: int) -> int | None:
    """Index after the last zero of the sum that signals at ``begin``; None for other charts.

    This is the usual estimate of when a shift began (Montgomery 9.1.2).
    """
    for charted in charts:
        chart = charted.chart
        if chart.name.startswith(SUM) and any(signal.index == begin for signal in chart.signals):
            zeros = np.flatnonzero(chart.points[:begin] == 0.0)
            return int(zeros[-1]) + 1 if len(zeros) else 0
    return None


def _find_active(charted: Charted) -> tuple[int, tuple[str, ...]] | None:
    """Index of the value at which the active signal began, and the rules that signalled since."""
    chart, first_index = charted.chart, len(charted.chart.points)
    for signal in reversed(chart.signals):
        if first_index - signal.index > (STANDS if first_index == len(chart.points) else JOINED):
            break
        first_index = signal.index
    if first_index == len(chart.points):
        return None
    chart_prefix = f"{chart.name}, " if chart.name not in ("individuals", "means") else ""
    rules = dict.fromkeys(f"{chart_prefix}{signal.rule}" for signal in chart.signals if signal.index >= first_index)
    return charted.ends[first_index], tuple(rules)


#: Largest number of runs drawn; of longer charts the latest runs are drawn.
MOST_DRAWN: Final = 400
#: p value below which successive values are said to be alike.
_CORRELATION_LEVEL: Final = 0.05
#: Number of runs below which the uncertainty of limits is reported.
FEW_RUNS: Final = 25

# Notes on a chart.
_FEW: Final = "limits from {runs} runs are uncertain: false alarms may be several times as frequent"
_DOUBTFUL: Final = "the reference period itself breaks rules, so its limits are doubtful: {rules}"
_ANEW: Final = "{count} of the {runs} runs of the reference have a value now: some were analysed again"
_CORRELATED: Final = (
    "successive values of the reference period are alike (correlation {coefficient:.2f}, p = {p}): its limits, from"
    " the scatter of neighbours, are too narrow{share}"
)
_REST: Final = "the latest {runs} do not fill a group of {size} yet, and make no point"


@dataclass(frozen=True, slots=True)
class PointSignal:
    """A rule broken by a point, and its run."""

    run: str
    rule: str


@dataclass(frozen=True, slots=True, eq=False)
class ChartPhase:
    """One chart of one phase, ``"reference"`` or ``"monitored"``; points and limits in the unit of the values.

    Parameters
    ----------
    runs : run of each point; for a group the last.
    """

    name: str
    phase: str
    runs: tuple[str, ...]
    points: tuple[float, ...]
    centre: float
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    signals: tuple[PointSignal, ...]


@dataclass(frozen=True, slots=True, eq=False)
class MetricChart:
    """One metric's charts.

    Parameters
    ----------
    why : reason for a missing reference and chart.
    reference_days : days of the first and last run of the reference (UTC).
    runs, values : runs and their values from the first run of the reference; ``reference_runs`` of them belong to it.
    charts : charts of the reference period, then of later runs, with the same limits.
    """

    label: str
    unit: str
    runs: tuple[str, ...]
    values: tuple[float, ...]
    notes: tuple[str, ...]
    why: str = ""
    reference: ChartReference | None = None
    reference_days: tuple[date, date] | None = None
    reference_runs: int = 0
    signal: StandingSignal | None = None
    charts: tuple[ChartPhase, ...] = ()


def refuse_chart(series: Series, why: str) -> MetricChart:
    """Return a metric without limits, and the reason."""
    return MetricChart(series.key.title, series.unit, _names(series.lines), series.values, series.notes, why)


def metric_chart(series: Series, reference: ChartReference) -> MetricChart:
    """Chart a metric against a reference; no charts if the runs have another unit."""
    if series.unit != reference.unit:
        return refuse_chart(series, f"runs are in {series.unit}, the reference in {reference.unit}")
    lines, count = series.lines, sum(line.run <= reference.last_run for line in series.lines)
    standard = Standard(reference.mean, reference.deviation)
    reference_charts = _charts(series.values[:count], reference, standard)
    monitored_charts = _charts(series.values[count:], reference, standard)
    doubtful_rules = dict.fromkeys(signal.rule for charted in reference_charts for signal in charted.chart.signals)
    ungrouped_count = (len(series.values) - count) % reference.subgroup
    notes = (
        _FEW.format(runs=reference.runs) if reference.runs < FEW_RUNS else "",
        _DOUBTFUL.format(rules=list_names(list(doubtful_rules))) if doubtful_rules else "",
        _describe_correlation(series.values[:count], reference),
        _ANEW.format(count=count, runs=reference.runs) if count != reference.runs else "",
        _REST.format(runs=plural(ungrouped_count, "run"), size=reference.subgroup) if ungrouped_count else "",
    )
    return MetricChart(
        label=reference.label,
        unit=series.unit,
        runs=_names(lines),
        values=series.values,
        notes=(*series.notes, *filter(None, notes)),
        reference=reference,
        reference_days=(lines[0].day, lines[count - 1].day) if count else None,
        reference_runs=count,
        signal=standing(monitored_charts, lines[count:], reference, cut=False),
        charts=(
            *_phases(reference_charts, lines, "reference"),
            *_phases(monitored_charts, lines[count:], "monitored"),
        ),
    )


def _describe_correlation(values: Sequence[float], settings: ChartSettings) -> str:
    """Return a note if the values of a reference period depend on those before them; else empty."""
    if len(values) < FEWEST or settings.chart is ChartKind.MEANS:
        return ""
    correlation = correlate_successive(values)
    if correlation.p > _CORRELATION_LEVEL or correlation.coefficient <= 0:
        return ""
    coefficient = correlation.coefficient
    shares: tuple[float, ...] = ()
    if settings.chart is ChartKind.EWMA:
        shares = tuple(ewma_beyond(value, settings.weight, settings.width) for value in (0.0, coefficient))
    elif settings.chart is ChartKind.INDIVIDUALS:
        shares = (individuals_beyond(0.0), individuals_beyond(coefficient))
    share = ", and false signals are several times as frequent"
    if shares:
        usual, beyond = (number(100 * value, 2) for value in shares)
        share = f": some {beyond} % of undisturbed runs are beyond them, instead of {usual} %"
    return _CORRELATED.format(coefficient=coefficient, p=number(correlation.p, 2), share=share)


def _charts(values: Sequence[float], settings: ChartSettings, standard: Standard) -> tuple[Charted, ...]:
    return charts_of(values, settings, standard) if len(values) >= settings.subgroup else ()


def _phases(charts: Sequence[Charted], lines: Sequence[RunLine], phase: str) -> Iterator[ChartPhase]:
    for chart, runs in ((charted.chart, _names([lines[end] for end in charted.ends])) for charted in charts):
        limits = tuple(chart.lower.tolist()), tuple(chart.upper.tolist())
        signals = tuple(PointSignal(runs[signal.index], signal.rule) for signal in chart.signals)
        yield ChartPhase(chart.name, phase, runs, tuple(chart.points.tolist()), chart.centre, *limits, signals)


def _names(lines: Sequence[RunLine]) -> tuple[str, ...]:
    return tuple(line.run for line in lines)


def reference_figures(
    table: FleetTable, references: Iterable[ChartReference]
) -> dict[MetricKey, dict[str, RunFigure]]:
    """Return the values behind references, by metric and run."""
    figures: dict[MetricKey, dict[str, RunFigure]] = {}
    for by_location in {bool(reference.location) for reference in references}:
        figures |= figures_of(table, by_location=by_location)
    return figures
