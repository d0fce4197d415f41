"""Tables and figures of a comparison."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

from cbsr_qa.domain import of_kind
from cbsr_qa.domain.results import Block, Figure, Paragraph, Section, Table
from cbsr_qa.report import number, plural, text_table, unit_column, unit_shown
from cbsr_qa.stats import Index, Interval
from cbsr_qa.studies.compare.comparison import Comparison, MetricComparison
from cbsr_qa.studies.compare.describe import Distribution
from cbsr_qa.studies.compare.differences import Difference, Estimated, PlaceDifference
from cbsr_qa.studies.compare.terms import By

_MOST_DRAWN: Final = 12
_NONE: Final = "–"
_DIFFERENCES: Final = "{pair}, {taken_out}; model: {models}."
_ALIKE: Final = (
    "{pair}: alike within a margin? The {decides:g} % interval decides one such test; p is adjusted for all."
)
_OTHER: Final = (
    "{pair} by other methods, p not adjusted: Welch's t test of one value a sensor, which ignores {others}, and "
    "Hodges and Lehmann's shift with differences of {others} taken out."
)
_TO_FIND: Final = "Sensors of each group that would find a difference with {power}."
_STATIONS: Final = "What stations read above the one with most runs, differences of {others} taken out."
_GROUPS: Final = "Sensors and yields as measured, stations' differences included, with Wilson's intervals."
_FAILURES: Final = "What sensors fail, most first; one sensor may fail several metrics."
_VALUES: Final = (
    "One value a sensor as measured, stations' differences included; spread is the standard deviation, percentages "
    "are quantiles."
)
_CAPABILITY: Final = "Capability against the recipe's limits, stations' differences included, with intervals."
_STRIPS: Final = (
    "{metric}: a row is a group at a station, a point a sensor (an outline where there are many). Line: mean; bar: "
    "middle half of the sensors."
)
_MAP: Final = (
    "{metric}: {pair} by place, differences of {others} taken out. Ringed: more than chance, adjusted for the places."
)
_BY_PLACE: Final = "{metric}: {pair} by place; p adjusted for the places."


def sections(found: Comparison) -> Iterator[Section]:
    """Lay out tables first, then what the page alone has."""
    drawn = _drawn(found)
    distributions: list[Block] = [_strips(metric, found) for metric in drawn]
    if drawn and len(drawn) < len(found.of_metrics):
        more = plural(len(found.of_metrics) - len(drawn), "metric")
        distributions.append(Paragraph(f"{more} more in the tables only.", "note"))
    for title, blocks, page_only in (
        ("Differences", _difference_tables(found), False),
        ("Stations", _stations_table(found), False),
        ("Groups", _group_tables(found), False),
        ("Distributions", distributions, True),
        ("Where on the sheet", (block for metric in drawn for block in _maps(metric, found)), True),
        ("Values of each group", (*_values_table(found), *_capability_table(found)), True),
        ("Rules", map(Paragraph, found.rules), True),
    ):
        laid_out = tuple(blocks)
        if laid_out:
            yield Section(title, laid_out, page_only)


def _difference_tables(found: Comparison) -> Iterator[Table]:
    terms, inside = found.terms, f"{100 * found.confidence:g} % interval"
    columns = ("metric", "difference", inside, "p", "effect size", "result")
    decides, power = 100 - 200 * terms.level, f"{100 * terms.power:g} %"
    of_likeness = ("metric", "margin", "difference", f"{decides:g} % interval", "p", "alike", f"sensors for {power}")
    for group in found.groups[1:]:
        pairs = [(metric, one) for metric, one in each(found) if one.group == group.name]
        words = {"pair": f"{group.name} − {found.reference}", "others": others(found), "taken_out": _taken_out(found)}
        models = ", ".join(dict.fromkeys(one.model.partition(":")[0] for _, one in pairs))
        rows = [_difference_row(*row, found) for row in pairs]
        yield from _table(_DIFFERENCES.format(**words, models=models), columns, rows, range(1, 5))
        rows = [_likeness_row(metric, group.name, found) for metric in _asked(found, terms.margins)]
        yield from _table(_ALIKE.format(**words, decides=decides), of_likeness, rows, (1, 2, 3, 4, 6))
        rows = [row for one in pairs for row in _other_rows(*one)]
        columns_of_others = ("metric", "method", "difference", inside, "p")
        yield from _table(_OTHER.format(**words), columns_of_others, rows, (2, 3, 4), folded=True)
    if len(found.groups) > 1:
        rows = [_needed_row(metric, terms.detect[metric.values.key.name]) for metric in _asked(found, terms.detect)]
        yield from _table(_TO_FIND.format(power=power), ("metric", "difference", "sensors of each"), rows, (1, 2))


def _difference_row(metric: MetricComparison, one: Difference, found: Comparison) -> tuple[str, ...]:
    effect = _NONE if one.effect_size is None else number(one.effect_size, 2)
    return (_label(metric), *_estimated(one), effect, _result(metric, one, found))


def _likeness_row(metric: MetricComparison, group: str, found: Comparison) -> tuple[str, ...]:
    margin = found.terms.margins[metric.values.key.name]
    asked = _label(metric), f"± {number(margin)}"
    one = next((one for one in metric.differences if one.group == group), None)
    if one is None or one.difference is None:
        return *asked, _NONE, _NONE, _NONE, "not tested", _NONE
    hopeless = abs(one.difference) >= margin
    return (
        *asked,
        number(one.difference),
        _ends(one.equivalence_interval),
        _p(one.equivalence_p),
        "yes" if one.equivalent else "not shown",
        "none would do" if hopeless else _count(one.sensors_to_show_alike),
    )


def _other_rows(metric: MetricComparison, one: Difference) -> Iterator[tuple[str, ...]]:
    """A row for each of the other methods that had an answer: numbers of both side by side would not fit a page."""
    if one.robust is not None:
        robust = one.robust
        shift = number(robust.shift), _ends(robust.interval), _p(robust.p)
        yield _label(metric), f"shift; {robust.method}", *shift
    if one.naive is not None:
        naive = one.naive
        yield _label(metric), "t test", number(naive.difference), _range(naive.low, naive.high), _p(naive.p)


def _needed_row(metric: MetricComparison, size: float) -> tuple[str, ...]:
    fitted = next((one for one in metric.differences if one.deviation is not None), None)
    return _label(metric), number(size), "not known" if fitted is None else _count(fitted.sensors_needed)


def _asked(found: Comparison, amounts: Mapping[str, float]) -> list[MetricComparison]:
    return [metric for metric in found.of_metrics if metric.values.key.name in amounts]


def _stations_table(found: Comparison) -> Iterator[Table]:
    rows = [
        (_label(metric), f"{one.station} − {one.reference}", *_estimated(one), _result(metric, one, found))
        for metric in found.of_metrics
        for one in metric.stations
    ]
    mixed = found.by in (By.MATERIAL, By.PERIOD, By.SOFTWARE) and len(_all_batches(found)) > 1
    caption = _STATIONS.format(others="batches" if mixed else "groups")
    columns = ("metric", "stations", "difference", f"{100 * found.confidence:g} % interval", "p", "result")
    return _table(caption, columns, rows, (2, 3, 4))


def _group_tables(found: Comparison) -> Iterator[Table]:
    columns = (str(found.by), "sensors", "runs", "yield", "first-pass yield", "not measured", "stations")
    rows = [
        (
            one.name,
            str(one.n),
            str(one.runs),
            _share(one.passed, one.yield_interval),
            _share(one.first_pass_yield, one.first_pass_yield_interval),
            str(one.not_measured or ""),
            ", ".join(one.stations),
        )
        for one in found.groups
    ]
    yield from _table(_GROUPS, columns, rows, (1, 2, 5))
    failed = []
    for group in found.groups:
        total = sum(one.sensors for one in group.failures)
        failed += [
            (group.name, one.metric, str(one.sensors), f"{100 * one.sensors / total:.0f} %")
            for one in group.failures[:_MOST_DRAWN]
        ]
    yield from _table(_FAILURES, (str(found.by), "metric", "sensors", "of all failures"), failed, (2, 3))


def _drawn(found: Comparison) -> list[MetricComparison]:
    def rank(metric: MetricComparison) -> tuple[float, bool]:
        p_values = [one.p or 0.0 for one in metric.differences if significant(one, found)]
        return min(p_values, default=1.0), not metric.values.limited

    members = [metric for metric in found.of_metrics if any(len(values) for *_, values in metric.samples)]
    return sorted(members, key=rank)[:_MOST_DRAWN]


def _strips(metric: MetricComparison, found: Comparison) -> Figure:
    shown = [one for one in metric.samples if len(one[2])]

    def draw() -> str:
        # matplotlib is loaded only where something is drawn
        from cbsr_qa.studies.compare.figures import strips

        return strips(_label(metric), shown, [group.name for group in found.groups])

    words = "; ".join(
        f"{group} on {station}: {len(v)} sensors, mean {number(float(v.mean()))}" for group, station, v in shown
    )
    return Figure(_STRIPS.format(metric=capital(metric.values.title)), words, draw)


def _maps(metric: MetricComparison, found: Comparison) -> Iterator[Block]:
    title = capital(metric.values.title)
    for one in metric.differences:
        if not one.places:
            continue
        pair = f"{one.group} − {one.reference}"
        known = [(p.x_mm, p.y_mm, p) for p in one.places if p.x_mm is not None and p.y_mm is not None]
        if known:
            words = "; ".join(f"{place.location}: {number(place.difference)}" for *_, place in known)
            caption = _MAP.format(metric=title, pair=pair, others=others(found))
            yield Figure(caption, words, partial(_draw_map, metric.values.unit, known, found.terms.level))
        rows = [(p.location, number(p.difference), _range(p.low, p.high), _p(p.p)) for p in one.places]
        columns = (
            "place",
            unit_column("difference", metric.values.unit),
            f"{100 * found.confidence:g} % interval",
            "p",
        )
        yield from _table(_BY_PLACE.format(metric=title, pair=pair), columns, rows, (1, 2, 3), folded=True)


def _draw_map(unit: str, places: Sequence[tuple[float, float, PlaceDifference]], level: float) -> str:
    from cbsr_qa.studies.compare.figures import difference_map  # as above

    return difference_map(unit, places, level)


def _values_table(found: Comparison) -> Iterator[Table]:
    columns = ("metric", "group", "n", "mean", "spread", "5 %", "25 %", "median", "75 %", "95 %")
    rows = [
        (_label(metric), one.group, str(one.n), *_moments(one))
        for metric in found.of_metrics
        for one in metric.distributions
    ]
    return _table(_VALUES, columns, rows, range(2, 10))


def _moments(one: Distribution) -> tuple[str, ...]:
    moments = [one.mean, one.deviation, *one.quantiles.values()]
    return tuple(_NONE if value is None else number(value) for value in (*moments, *[None] * (7 - len(moments))))


def _capability_table(found: Comparison) -> Iterator[Table]:
    rows = []
    for metric in found.of_metrics:
        for one in metric.distributions if metric.values.limited else ():
            index = one.capability
            indices = (None,) * 4 if index is None else (index.cp, index.cpk, index.pp, index.ppk)
            rows.append((_label(metric), one.group, *map(_index, indices), one.no_capability or ""))
    return _table(_CAPABILITY, ("metric", "group", "Cp", "Cpk", "Pp", "Ppk", "why not"), rows, (2, 3, 4, 5))


def _table(
    caption: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    numeric: Sequence[int],
    *,
    folded: bool = False,
) -> Iterator[Table]:
    """Lay rows out, if there are any, without columns that are empty."""
    kept = [k for k in range(len(columns)) if any(row[k] for row in rows)]
    if kept:
        cells = [[row[k] for k in kept] for row in rows]
        right = [place for place, k in enumerate(kept) if k in numeric]
        yield replace(text_table(caption, [columns[k] for k in kept], cells, right), folded=folded)


def each(found: Comparison) -> Iterator[tuple[MetricComparison, Difference]]:
    """Go through all differences with their metrics."""
    return ((metric, one) for metric in found.of_metrics for one in metric.differences)


def significant(one: Estimated, found: Comparison) -> bool:
    """Whether an adjusted p value is below the level."""
    return one.p is not None and one.p < found.terms.level


def side(metric: MetricComparison, one: Estimated, found: Comparison) -> str:
    """Say on which side of its reference a group lies; better or worse where one limit says which that is."""
    above, values = (one.difference or 0.0) > 0, metric.values
    if (
        isinstance(one, Difference)
        and found.by is not By.STATION
        and (values.lower is None) != (values.upper is None)
    ):
        return "worse than" if above is (values.lower is None) else "better than"
    return "above" if above else "below"


def _result(metric: MetricComparison, one: Estimated, found: Comparison) -> str:
    if one.difference is None:
        return "not compared"
    return side(metric, one, found).removesuffix(" than") if significant(one, found) else "not shown"


def others(found: Comparison) -> str:
    """Return what must not be taken for a group: batches too, where periods or software versions are compared."""
    if found.by is By.STATION:
        return "batches"
    mixed = found.by in (By.PERIOD, By.SOFTWARE) and len(_all_batches(found)) > 1
    return "stations and batches" if mixed else "stations"


def _taken_out(found: Comparison) -> str:
    kind, members = others(found), {"stations": all_stations(found), "batches": _all_batches(found)}
    if len(members.get(kind, ())) == 1:
        return f"all of {of_kind('station' if kind == 'stations' else 'batch', members[kind][0])}"
    return f"differences of {kind} taken out"


def all_stations(found: Comparison) -> list[str]:
    """Return the stations of all groups, sorted."""
    return sorted({name for group in found.groups for name in group.stations})


def _all_batches(found: Comparison) -> list[str]:
    return sorted({name for group in found.groups for name in group.batches})


def _label(metric: MetricComparison) -> str:
    return unit_column(metric.values.title, metric.values.unit)


def amount(value: float, unit: str, digits: int = 3) -> str:
    """Write a value with its unit, as it stands in a sentence."""
    return f"{number(value, digits)} {unit_shown(unit)}".rstrip()


def _estimated(one: Estimated) -> tuple[str, str, str]:
    if one.difference is None or one.low is None or one.high is None:
        return _NONE, _NONE, _NONE
    return number(one.difference), _range(one.low, one.high), _p(one.p)


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


def _index(index: Index | None) -> str:
    return _NONE if index is None else f"{index.value:.2f} ({index.low:.2f} to {index.high:.2f})"


def _share(share: float | None, inside: Interval | None) -> str:
    if share is None or inside is None:
        return "not judged"
    return f"{100 * share:.1f} % ({100 * inside.low:.0f} to {100 * inside.high:.0f} %)"


def capital(text: str) -> str:
    """Begin with a capital letter."""
    return f"{text[:1].upper()}{text[1:]}"
