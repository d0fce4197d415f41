"""The words of ``cbsr-qa gauge``: a table a metric, with sentences below it."""

import textwrap
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from cbsr_qa.config.echo import printable

if TYPE_CHECKING:
    from cbsr_qa.app.gauge import Gauge, MetricGauge
    from cbsr_qa.app.gauge_references import AgainstReferences

WIDTH = 100
_PARTS = (
    ("repeatability", "repeatability"),
    ("reproducibility", "reproducibility"),
    ("gauge", "gauge (R&R)"),
    ("sensor", "sensors"),
    ("total", "total"),
)


def lines(found: "Gauge") -> Iterator[str]:
    """Lay a study out, one line after another."""
    from cbsr_qa.app.gauge_words import source_words, study_words

    if found.request.source is not None:
        yield from _wrapped("file     ", printable(source_words(found.request.source)))
    yield from _wrapped("study    ", printable(study_words(found)))
    for words in found.notes:
        yield from _wrapped("note     ", printable(words))
    for one in found.metrics:
        yield ""
        unit = "" if one.series.unit == "1" else f", {one.series.unit}"
        yield printable(f"{one.series.key.label}{unit}")
        yield from _metric(one, found.request.appraiser, found.request.confidence)


def _metric(one: "MetricGauge", appraiser: str, confidence: float) -> Iterator[str]:
    from cbsr_qa.app.gauge_words import metric_words

    if one.anova is not None and one.ranges is not None:
        yield from _columns(_components(one, confidence))
    for words in metric_words(one, appraiser, confidence):
        yield from _wrapped("    ", printable(words))
    if one.against is not None:
        yield from _against(one.against, appraiser, confidence)


def _components(one: "MetricGauge", confidence: float) -> Iterator[tuple[str, ...]]:
    from cbsr_qa.app.gauge_words import deviation_words, percent
    from cbsr_qa.report.numbers import number

    assert one.anova is not None
    assert one.ranges is not None
    yield "", "deviation", f"{100 * confidence:g} % interval", "variance", "study", "tolerance", "by ranges"
    variation, by_range = one.anova.variation, one.ranges.variation
    for name, shown in _PARTS:
        part = getattr(variation, name)
        tolerance = variation.percent_tolerance(part)
        yield (
            shown,
            number(part.deviation, 4),
            deviation_words(part),
            percent(variation.percent_contribution(part)),
            percent(variation.percent_study(part)),
            "–" if tolerance is None else percent(tolerance),
            number(getattr(by_range, name).deviation, 4),
        )


def _columns(rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    """Lay rows out in columns as wide as what stands in them."""
    table = list(rows)
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for first, *rest in table:
        cells = (f"{cell:>{width}}" for cell, width in zip(rest, widths[1:], strict=True))
        yield f"  {first:<{widths[0]}}  {'  '.join(cells)}"


def _against(found: "AgainstReferences", appraiser: str, confidence: float) -> Iterator[str]:
    from cbsr_qa.app.gauge_reference_words import reference_words

    for words in reference_words(found, appraiser, confidence):
        yield from _wrapped("    ", printable(words))


def _wrapped(start: str, text: str) -> Iterator[str]:
    indent = " " * len(start) if start.strip() else f"{start}  "
    yield from textwrap.wrap(
        text, WIDTH, initial_indent=start, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
