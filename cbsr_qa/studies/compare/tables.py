"""Tables and figures of a comparison."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

from cbsr_qa.domain.numbers import prefix_kind
from cbsr_qa.domain.results.report import Block, Figure, Paragraph, Section, Table
from cbsr_qa.report.tables import capital, number, plural, text_table, unit_column, unit_shown
from cbsr_qa.stats.process_capability import Capability, Index
from cbsr_qa.stats.samples import Interval
from cbsr_qa.studies.compare.comparison import Comparison, MetricComparison
from cbsr_qa.studies.compare.describe import QUANTILES
from cbsr_qa.studies.compare.differences import Difference, Estimated, PlaceDifference
from cbsr_qa.studies.compare.fitted import build_fit_blocks
from cbsr_qa.studies.compare.terms import By

_MAX_DRAWN: Final = 12
_NONE: Final = "–"
_DIFFERENCES: Final = "{pair}, {taken_out}; model: {models}."
_ALIKE: Final = (
    "{pair}: alike within a margin? The {decides:g} % interval decides one such test; p is adjusted for all."
)
_OTHER: Final = (
    "{pair} by other methods, p not adjusted: Welch's t test ignores {others}; Hodges and Lehmann's shift does not."
)
_TO_FIND: Final = "Sensors of each group that would find a difference with {power}."
_STATIONS: Final = "Differences of stations from the one with most runs, adjusted for {others}."
_GROUPS: Final = "Sensors and yields as measured, not adjusted for stations, with Wilson intervals."
_FAILURES: Final = "Failed metrics, most frequent first; one sensor may fail several."
_VALUES: Final = (
    "One value per sensor as measured, not adjusted for stations; spread is the standard deviation, percentages "
    "are quantiles."
)
_CAPABILITY: Final = (
    "Capability against the recipe's limits, not adjusted for stations, with intervals. Only of normal values do Cp"
    " to Ppk tell the share beyond the limits; Ppk by percentiles is for values of any shape."
)
_STRIPS: Final = (
    "{metric}: a row is a group at a station, a point a sensor (an outline where there are many). Line: mean; bar: "
    "middle half of the sensors."
)
_MAP: Final = (
    "{metric}: {pair} by place, adjusted for {others}. Ringed: significant, with p adjusted for the number of places."
)
_BY_PLACE: Final = "{metric}: {pair} by place; p adjusted for the places."


def sections(comparison: Comparison) -> Iterator[Section]:
    """Lay out tables first, then the parts that only the page has."""
    drawn_metrics = _select_for_figure(comparison)
    distributions: list[Block] = [_strips(metric, comparison) for metric in drawn_metrics]
    if drawn_metrics and len(drawn_metrics) < len(comparison.of_metrics):
        more_words = plural(len(comparison.of_metrics) - len(drawn_metrics), "metric")
        distributions.append(Paragraph(f"{more_words} more in the tables only.", "note"))
    for title, blocks, page_only in (
        ("Differences", _difference_tables(comparison), False),
        ("Stations", _stations_table(comparison), False),
        ("Groups", _group_tables(comparison), False),
        ("Distributions", distributions, True),
        ("Where on the sheet", (block for metric in drawn_metrics for block in _maps(metric, comparison)), True),
        ("Values of each group", (*_values_table(comparison), *_capability_table(comparison)), True),
        ("Capability by a fitted distribution", build_fit_blocks(comparison.of_metrics), False),
        ("Rules", map(Paragraph, comparison.rules), True),
    ):
        section_blocks = tuple(blocks)
        if section_blocks:
            yield Section(title, section_blocks, page_only)


def _difference_tables(comparison: Comparison) -> Iterator[Table]:
    terms, interval_column = comparison.terms, f"{100 * comparison.confidence:g} % interval"
    columns = ("metric", "difference", interval_column, "p", "effect size", "result")
    decision_percent, power = 100 - 200 * terms.level, f"{100 * terms.power:g} %"
    decision_column = f"{decision_percent:g} % interval"
    likeness_columns = ("metric", "margin", "difference", decision_column, "p", "alike", f"sensors for {power}")
    kinds = {"stations": ("station", comparison.all_stations), "batches": ("batch", comparison.all_batches)}
    kind, names = kinds.get(comparison.others, ("", []))
    adjusted = f"all of {prefix_kind(kind, names[0])}" if len(names) == 1 else f"adjusted for {comparison.others}"
    for group in comparison.groups[1:]:
        pairs = [(metric, difference) for metric, difference in comparison.pairs if difference.group == group.name]
        caption_words = {
            "pair": f"{group.name} − {comparison.reference}",
            "others": comparison.others,
            "taken_out": adjusted,
        }
        models = ", ".join(dict.fromkeys(difference.model.partition(":")[0] for _, difference in pairs))
        rows: list[tuple[str, ...]] = []
        for metric, difference in pairs:
            effect = _NONE if difference.effect_size is None else number(difference.effect_size, 2)
            result = _result(metric, difference, comparison)
            rows.append((_label(metric), *_format_estimate(difference), effect, result))
        yield from _table(_DIFFERENCES.format(**caption_words, models=models), columns, rows, range(1, 5))
        rows = [
            _likeness_row(metric, group.name, comparison) for metric in _select_metrics(comparison, terms.margins)
        ]
        yield from _table(
            _ALIKE.format(**caption_words, decides=decision_percent), likeness_columns, rows, (1, 2, 3, 4, 6)
        )
        rows = [row for pair in pairs for row in _list_other_methods(*pair)]
        other_columns = ("metric", "method", "difference", interval_column, "p")
        yield from _table(_OTHER.format(**caption_words), other_columns, rows, (2, 3, 4), folded=True)
    if len(comparison.groups) > 1:
        yield from _sensors_table(comparison, power)


def _sensors_table(comparison: Comparison, power: str) -> Iterator[Table]:
    rows = []
    for metric in _select_metrics(comparison, comparison.terms.detect):
        size = comparison.terms.detect[metric.values.key.name]
        fitted = next((difference for difference in metric.differences if difference.deviation is not None), None)
        sensors = "not known" if fitted is None else _count(fitted.sensors_needed)
        rows.append((_label(metric), number(size), sensors))
    return _table(_TO_FIND.format(power=power), ("metric", "difference", "sensors of each"), rows, (1, 2))


def _likeness_row(metric: MetricComparison, group: str, comparison: Comparison) -> tuple[str, ...]:
    margin = comparison.terms.margins[metric.values.key.name]
    first_cells = _label(metric), f"± {number(margin)}"
    pair = next((difference for difference in metric.differences if difference.group == group), None)
    if pair is None or pair.difference is None:
        return *first_cells, _NONE, _NONE, _NONE, "not tested", _NONE
    is_hopeless = abs(pair.difference) >= margin
    return (
        *first_cells,
        number(pair.difference),
        _ends(pair.equivalence_interval),
        _p(pair.equivalence_p),
        "yes" if pair.equivalent else "not shown",
        "not possible" if is_hopeless else _count(pair.sensors_to_show_alike),
    )


def _list_other_methods(metric: MetricComparison, difference: Difference) -> Iterator[tuple[str, ...]]:
    """Rows of the other methods with a result: columns for both would not fit a page."""
    if difference.robust is not None:
        robust = difference.robust
        shift = number(robust.shift), _ends(robust.interval), _p(robust.p)
        yield _label(metric), f"shift; {robust.method}", *shift
    if difference.naive is not None:
        naive = difference.naive
        yield _label(metric), "t test", number(naive.difference), _range(naive.low, naive.high), _p(naive.p)


def _select_metrics(comparison: Comparison, amounts: Mapping[str, float]) -> list[MetricComparison]:
    return [metric for metric in comparison.of_metrics if metric.values.key.name in amounts]


def _stations_table(comparison: Comparison) -> Iterator[Table]:
    rows = [
        (
            _label(metric),
            f"{station.station} − {station.reference}",
            *_format_estimate(station),
            _result(metric, station, comparison),
        )
        for metric in comparison.of_metrics
        for station in metric.stations
    ]
    mixed = comparison.by in (By.MATERIAL, By.PERIOD, By.SOFTWARE) and len(comparison.all_batches) > 1
    caption = _STATIONS.format(others="batches" if mixed else "groups")
    columns = ("metric", "stations", "difference", f"{100 * comparison.confidence:g} % interval", "p", "result")
    return _table(caption, columns, rows, (2, 3, 4))


def _group_tables(comparison: Comparison) -> Iterator[Table]:
    columns = (str(comparison.by), "sensors", "runs", "yield", "first-pass yield", "not measured", "stations")
    rows = [
        (
            of_group.name,
            str(of_group.n),
            str(of_group.runs),
            _share(of_group.passed, of_group.yield_interval),
            _share(of_group.first_pass_yield, of_group.first_pass_yield_interval),
            str(of_group.not_measured or ""),
            ", ".join(of_group.stations),
        )
        for of_group in comparison.groups
    ]
    yield from _table(_GROUPS, columns, rows, (1, 2, 5))
    failed_rows = []
    for group in comparison.groups:
        total = sum(failure.sensors for failure in group.failures)
        failed_rows += [
            (group.name, failure.metric, str(failure.sensors), f"{100 * failure.sensors / total:.0f} %")
            for failure in group.failures[:_MAX_DRAWN]
        ]
    yield from _table(_FAILURES, (str(comparison.by), "metric", "sensors", "of all failures"), failed_rows, (2, 3))


def _select_for_figure(comparison: Comparison) -> list[MetricComparison]:
    def rank(metric: MetricComparison) -> tuple[float, bool]:
        p_values = [difference.p or 0.0 for difference in metric.differences if comparison.significant(difference)]
        return min(p_values, default=1.0), not metric.values.limited

    members = [metric for metric in comparison.of_metrics if any(len(values) for *_, values in metric.samples)]
    return sorted(members, key=rank)[:_MAX_DRAWN]


def _strips(metric: MetricComparison, comparison: Comparison) -> Figure:
    samples = [sample for sample in metric.samples if len(sample[2])]

    def draw() -> str:
        # loads matplotlib
        from cbsr_qa.studies.compare.figures import strips

        return strips(_label(metric), samples, [group.name for group in comparison.groups])

    description = "; ".join(
        f"{group} on {station}: {len(v)} sensors, mean {number(float(v.mean()))}" for group, station, v in samples
    )
    return Figure(_STRIPS.format(metric=capital(metric.values.title)), description, draw)


def _maps(metric: MetricComparison, comparison: Comparison) -> Iterator[Block]:
    title = capital(metric.values.title)
    for difference in metric.differences:
        if not difference.places:
            continue
        pair = f"{difference.group} − {difference.reference}"
        located_places = [(p.x_mm, p.y_mm, p) for p in difference.places if p.x_mm is not None and p.y_mm is not None]
        if located_places:
            description = "; ".join(f"{place.location}: {number(place.difference)}" for *_, place in located_places)
            caption = _MAP.format(metric=title, pair=pair, others=comparison.others)
            yield Figure(
                caption, description, partial(_draw_map, metric.values.unit, located_places, comparison.terms.level)
            )
        rows = [(p.location, number(p.difference), _range(p.low, p.high), _p(p.p)) for p in difference.places]
        columns = (
            "place",
            unit_column("difference", metric.values.unit),
            f"{100 * comparison.confidence:g} % interval",
            "p",
        )
        yield from _table(_BY_PLACE.format(metric=title, pair=pair), columns, rows, (1, 2, 3), folded=True)


def _draw_map(unit: str, places: Sequence[tuple[float, float, PlaceDifference]], level: float) -> str:
    from cbsr_qa.studies.compare.figures import difference_map  # as above

    return difference_map(unit, places, level)


def _values_table(comparison: Comparison) -> Iterator[Table]:
    quantile_names = ("median" if share == 0.5 else f"{100 * share:g} %" for share in QUANTILES)
    columns = ("metric", "group", "n", "mean", "spread", *quantile_names)
    rows = []
    for metric in comparison.of_metrics:
        for distribution in metric.distributions:
            quantiles = [distribution.quantiles.get(f"{share:g}") for share in QUANTILES]
            values = (distribution.mean, distribution.deviation, *quantiles)
            words = [_NONE if value is None else number(value) for value in values]
            rows.append((_label(metric), distribution.group, str(distribution.n), *words))
    return _table(_VALUES, columns, rows, range(2, len(columns)))


def _capability_table(comparison: Comparison) -> Iterator[Table]:
    rows = []
    for metric in comparison.of_metrics:
        for distribution in metric.distributions if metric.values.limited else ():
            found = distribution.capability
            indices = (None,) * 4 if found is None else (found.cp, found.cpk, found.pp, found.ppk)
            words = [_NONE if index is None else _format_index(index) for index in indices]
            percentile = distribution.percentile_ppk
            by_percentiles = distribution.no_percentile_ppk or _NONE
            words += [_describe_normality(found), by_percentiles if percentile is None else _format_index(percentile)]
            rows.append((_label(metric), distribution.group, *words, distribution.no_capability or ""))
    columns = ("metric", "group", "Cp", "Cpk", "Pp", "Ppk", "normal?", "Ppk by percentiles", "why not")
    return _table(_CAPABILITY, columns, rows, (2, 3, 4, 5, 7))


def _format_index(index: Index) -> str:
    return f"{index.value:.2f} ({index.low:.2f} to {index.high:.2f})"


def _describe_normality(found: Capability | None) -> str:
    """Say what the test of normality says, and whether it has enough values to mean something."""
    if found is None or found.normality is None:
        return _NONE
    test = found.normality
    if test.refuted:
        return f"no (p: {_p(test.p_value)})"
    return f"not refuted (p: {_p(test.p_value)})" if test.telling else f"{found.count} values cannot tell"


def _table(
    caption: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    numeric: Sequence[int],
    *,
    folded: bool = False,
) -> Iterator[Table]:
    """Lay out rows, if any, without empty columns."""
    filled_columns = [k for k in range(len(columns)) if any(row[k] for row in rows)]
    if filled_columns:
        cells = [[row[k] for k in filled_columns] for row in rows]
        right = [place for place, k in enumerate(filled_columns) if k in numeric]
        yield replace(text_table(caption, [columns[k] for k in filled_columns], cells, right), folded=folded)


def _result(metric: MetricComparison, difference: Estimated, comparison: Comparison) -> str:
    if difference.difference is None:
        return "not compared"
    if not comparison.significant(difference):
        return "not shown"
    return comparison.side(metric, difference).removesuffix(" than")


def _label(metric: MetricComparison) -> str:
    return unit_column(metric.values.title, metric.values.unit)


def amount(value: float, unit: str, digits: int = 3) -> str:
    """Format a value with its unit for a sentence."""
    return f"{number(value, digits)} {unit_shown(unit)}".rstrip()


def _format_estimate(difference: Estimated) -> tuple[str, str, str]:
    if difference.difference is None or difference.low is None or difference.high is None:
        return _NONE, _NONE, _NONE
    return number(difference.difference), _range(difference.low, difference.high), _p(difference.p)


def _range(low: float, high: float) -> str:
    return f"{number(low)} to {number(high)}"


def _ends(interval: Interval | None) -> str:
    return _NONE if interval is None else _range(interval.low, interval.high)


def _p(p_value: float | None) -> str:
    """Write a p value with two digits: ``0.012``, ``0.50``, ``< 0.0001``."""
    if p_value is None:
        return _NONE
    return "< 0.0001" if p_value < 1e-4 else f"{p_value:#.2g}"


def _count(sensors: int | None) -> str:
    return "> 10⁹" if sensors is None else str(sensors)


def _share(share: float | None, inside: Interval | None) -> str:
    if share is None or inside is None:
        return "not judged"
    return f"{100 * share:.1f} % ({100 * inside.low:.0f} to {100 * inside.high:.0f} %)"
