"""Capability by a fitted distribution, as tables and figures of a comparison."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from cbsr_qa.domain.results.report import Block, Figure, Paragraph, Table
from cbsr_qa.report.tables import capital, list_names, number, text_table, unit_column
from cbsr_qa.stats.fitted_capability import FittedCapability
from cbsr_qa.stats.normality import LEVEL
from cbsr_qa.stats.process_capability import Index
from cbsr_qa.studies.compare.comparison import MetricComparison
from cbsr_qa.studies.compare.describe import Distribution

_NONE: Final = "–"
_CAPABILITY: Final = (
    "Pp and Ppk by the points of 0.135, 50 and 99.865 % of a fitted distribution (ISO 22514-4), and the parts per "
    "million that it puts beyond the limits, with intervals. A p below 0.05 (Anderson and Darling) refutes it. There "
    "is no Cp or Cpk of values that are not normal."
)
_NOT_FITTED: Final = "{metric}, {groups}: no distribution was fitted: {why}."
_COMPARED: Final = "{metric}, {group}: distributions, the best first; less A² and AIC fit better."
_HISTOGRAM: Final = (
    "{metric}, {group}: {count} values, the {family} distribution fitted to them, and the limits (dashed)."
)
_REFUTED: Final = "{metric}, {group}: the values refute the {family} distribution (p: {p}); do not use its indices."


def build_fit_blocks(metrics: tuple[MetricComparison, ...]) -> Iterator[Block]:
    """Lay out what was fitted; nothing if no distribution was asked for."""
    rows: list[tuple[str, ...]] = []
    others: list[Block] = []
    groups_by_reason: dict[tuple[str, str], list[str]] = {}
    for metric in metrics:
        for distribution in metric.distributions:
            fitted = distribution.fitted_capability
            if fitted is not None:
                rows.append((_label(metric), distribution.group, *_list_cells(fitted)))
                others += _detail(metric, distribution, fitted)
            elif distribution.no_fitted_capability is not None and metric.values.limited:
                reason = capital(metric.values.title), distribution.no_fitted_capability
                groups_by_reason.setdefault(reason, []).append(distribution.group)
    if rows:
        columns = ("metric", "group", "distribution", "p", "Pp", "Ppk", "ppm beyond")
        filled = [place for place in range(len(columns)) if any(row[place] != _NONE for row in rows)]
        cells_of_rows = [[row[place] for place in filled] for row in rows]
        right = [place for place, column in enumerate(filled) if column > 2]
        yield text_table(_CAPABILITY, [columns[place] for place in filled], cells_of_rows, right)
    for (title, why), groups in groups_by_reason.items():
        yield Paragraph(_NOT_FITTED.format(metric=title, groups=list_names(groups, 5), why=why), "note")
    yield from others


def _list_cells(fitted: FittedCapability) -> tuple[str, ...]:
    ppm = fitted.ppm
    return (
        f"{fitted.fit.family}, {fitted.chosen}",
        f"{fitted.p_value:.2g}",
        _NONE if fitted.pp is None else _format_index(fitted.pp),
        _format_index(fitted.ppk),
        f"{_format_ppm(ppm.total)} ({_format_ppm(ppm.low)} to {_format_ppm(ppm.high)})",
    )


def _detail(metric: MetricComparison, distribution: Distribution, fitted: FittedCapability) -> Iterator[Block]:
    words = {"metric": capital(metric.values.title), "group": distribution.group, "family": fitted.fit.family}
    if fitted.p_value < LEVEL:
        yield Paragraph(_REFUTED.format(**words, p=f"{fitted.p_value:.2g}"), "warning")
    yield _figure(metric, fitted, words)
    yield _list_families(fitted, _COMPARED.format(**words))


def _figure(metric: MetricComparison, fitted: FittedCapability, words: dict[str, str]) -> Figure:
    values = fitted.values
    assert values is not None

    def draw() -> str:
        # loads matplotlib
        from cbsr_qa.studies.compare.figures import draw_fit_histogram

        return draw_fit_histogram(_label(metric), values, fitted.fit, metric.values.lower, metric.values.upper)

    low, middle, high = (number(point) for point in fitted.percentiles)
    description = f"0.135 % of the fitted distribution lies below {low}, half below {middle}, 99.865 % below {high}."
    return Figure(_HISTOGRAM.format(**words, count=len(values)), description, draw)


def _list_families(fitted: FittedCapability, caption: str) -> Table:
    rows = [
        (
            fit.family,
            number(fit.anderson_darling),
            number(fit.aic, 5),
            ", ".join(f"{name} {number(value)}" for name, value in fit.parameters.items()),
        )
        for fit in fitted.compared
    ]
    return replace(text_table(caption, ("distribution", "A²", "AIC", "parameters"), rows, (1, 2)), folded=True)


def _format_ppm(value: float) -> str:
    return "< 0.01" if value < 0.01 else number(value)


def _label(metric: MetricComparison) -> str:
    return unit_column(metric.values.title, metric.values.unit)


def _format_index(index: Index) -> str:
    return f"{index.value:.2f} ({index.low:.2f} to {index.high:.2f})"
