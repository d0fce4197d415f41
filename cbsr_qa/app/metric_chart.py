"""One metric's control charts: limits from a reference, the runs it rests on, and those since."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from cbsr_qa.app.charting import Charted, charts_of, standing
from cbsr_qa.app.figure_series import Series, named
from cbsr_qa.domain.run_figures import RunLine
from cbsr_qa.domain.station_charts import ChartReference, ChartSettings, StandingSignal
from cbsr_qa.report.numbers import plural
from cbsr_qa.stats.control_charts import Standard

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
