"""How a gauge stands to reference values: sentences for a terminal, tables for a page, of the same verdicts."""

from collections.abc import Iterable, Iterator
from typing import Final

from cbsr_qa.app.gauge_references import AgainstReferences, BiasLine, LinearityLine, ReferenceValue, StabilityLine
from cbsr_qa.app.gauge_words import interval_words, listed
from cbsr_qa.domain.report import Table
from cbsr_qa.report.numbers import number, plural, unit_shown, with_uncertainty
from cbsr_qa.report.tables import text_table, unit_column
from cbsr_qa.stats.gauge_reference import FEWEST_CHARTED, Linearity, Stability
from cbsr_qa.stats.gauge_study import on
from cbsr_qa.stats.referenced import Referenced

_NONE: Final = "–"


def reference_words(found: AgainstReferences, appraiser: str, confidence: float) -> Iterator[str]:
    """Say how the gauge stands to reference values, which are in the metric's unit."""
    by = on(appraiser)
    unit = f" {unit_shown(found.unit)}".rstrip()
    for one in found.biases:
        where = f"{one.reference.serial} {by} {one.appraiser}" if one.appraiser else one.reference.serial
        if one.bias is None:
            yield f"Bias of {where}: not known: {one.why}."
            continue
        inside = interval_words(one.bias.interval(confidence))
        yield (
            f"Bias of {where}: {number(one.bias.value)}{unit} ({inside}) against "
            f"{_reference(one.reference)}{unit} in {plural(one.count, 'run')}: {_bias_says(one.bias, confidence)}."
        )
    yield from _linearity_words(found, by, unit, confidence)
    yield from _stability_words(found, by, unit, confidence)


def reference_tables(found: AgainstReferences, appraiser: str, confidence: float) -> Iterator[Table]:
    """Lay out the same as up to three tables: bias, linearity, stability."""
    sure = f"{100 * confidence:g} % interval"
    head: tuple[str, ...]
    columns = ("sensor", appraiser, unit_column("reference", found.unit), "runs")
    if found.biases:
        rows = [_bias_row(one, confidence) for one in found.biases]
        head = (*columns, unit_column("bias", found.unit), sure, "p", "says")
        yield text_table(f"Bias against reference values{_whys(found.biases)}.", head, rows, (2, 3, 4, 5, 6))
    if found.linearity:
        rows = [_linearity_row(one, confidence) for one in found.linearity]
        head = (appraiser, "slope of the bias", sure, "with the value", "over the references")
        yield text_table(f"Linearity of the bias{_whys(found.linearity)}.", head, rows, (1, 2))
    if found.stability:
        rows = [_stability_row(one, confidence) for one in found.stability]
        head = ("sensor", appraiser, unit_column("drift a day", found.unit), sure, "its chart")
        yield text_table(f"Stability over time{_whys(found.stability)}.", head, rows, (2, 3))


def _reference(one: ReferenceValue) -> str:
    return with_uncertainty(one.value, one.uncertainty)


def _whys(lines: Iterable[BiasLine | LinearityLine | StabilityLine]) -> str:
    """Say once why some are not known: of many rows it is the same reason."""
    whys = tuple(dict.fromkeys(one.why for one in lines if one.why))
    return f"; a dash is not known: {listed(whys)}" if whys else ""


def _bias_row(one: BiasLine, confidence: float) -> tuple[str, ...]:
    said = (one.reference.serial, one.appraiser or _NONE, _reference(one.reference), str(one.count))
    if one.bias is None:
        return *said, _NONE, _NONE, _NONE, _NONE
    inside = interval_words(one.bias.interval(confidence))
    return *said, number(one.bias.value), inside, number(one.bias.p_value(), 2), _bias_says(one.bias, confidence)


def _linearity_row(one: LinearityLine, confidence: float) -> tuple[str, ...]:
    if one.linearity is None:
        return one.appraiser, _NONE, _NONE, _NONE, _NONE
    slope = one.linearity.rise()
    inside = interval_words(slope.interval(confidence))
    return (
        one.appraiser,
        number(slope.value),
        inside,
        _slope_says(one.linearity, confidence),
        _line_says(one.linearity, confidence),
    )


def _stability_row(one: StabilityLine, confidence: float) -> tuple[str, ...]:
    if one.stability is None:
        return one.reference.serial, one.appraiser, _NONE, _NONE, _NONE
    drift = one.stability.drift
    inside = interval_words(drift.interval(confidence))
    return one.reference.serial, one.appraiser, number(drift.value), inside, _chart_says(one.stability)


def _bias_says(found: Referenced, confidence: float) -> str:
    return "no bias is seen" if found.interval(confidence).holds(0.0) else "biased"


def _slope_says(found: Linearity, confidence: float) -> str:
    level = found.rise().interval(confidence).holds(0.0)
    return "no change of the bias with the value is seen" if level else "the bias goes with the value"


def _line_says(found: Linearity, confidence: float) -> str:
    return "no bias is seen" if found.acceptable(confidence) else "there is a bias somewhere"


def _chart_says(found: Stability) -> str:
    count = len(found.chart.points)
    if count < FEWEST_CHARTED:
        return f"{count} runs are too few for a chart to say anything ({FEWEST_CHARTED} at least)"
    return f"signals: {found.chart.signals[0].rule}" if found.chart.signals else "gives no signal"


def _linearity_words(found: AgainstReferences, by: str, unit: str, confidence: float) -> Iterator[str]:
    """Say of each appraiser whether the bias goes with the value, and whether there is any over the references."""
    unknown: dict[str, list[str]] = {}
    for one in found.linearity:
        if one.linearity is None:
            unknown.setdefault(one.why, []).append(one.appraiser)
            continue
        slope, references = one.linearity.rise(), one.linearity.references
        yield (
            f"Linearity {by} {one.appraiser}: slope of the bias {number(slope.value)} "
            f"({interval_words(slope.interval(confidence))}): {_slope_says(one.linearity, confidence)}; over the "
            f"references, {number(references[0])} to {number(references[-1])}{unit}, "
            f"{_line_says(one.linearity, confidence)}."
        )
    for why, names in unknown.items():
        yield f"Linearity {by} {listed(tuple(names))}: not known: {why}."


def _stability_words(found: AgainstReferences, by: str, unit: str, confidence: float) -> Iterator[str]:
    """Say of each reference and appraiser what it drifts, and what its chart says where it can say anything."""
    unknown: dict[str, list[str]] = {}
    for one in found.stability:
        where = f"{one.reference.serial} {by} {one.appraiser}"
        if one.stability is None:
            unknown.setdefault(one.why, []).append(where)
            continue
        drift, said = one.stability.drift, _chart_says(one.stability)
        its = said if one.stability.in_control is None else f"its chart {said}"
        inside = interval_words(drift.interval(confidence))
        yield f"Stability of {where}: drift {number(drift.value)}{unit} a day ({inside}); {its}."
    for why, names in unknown.items():
        yield f"Stability of {listed(tuple(names))}: not known: {why}."
