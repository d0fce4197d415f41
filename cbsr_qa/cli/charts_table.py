"""The words of ``cbsr-qa charts``: how the station stands, then each chart."""

import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING

from cbsr_qa.config.echo import printable

if TYPE_CHECKING:
    from cbsr_qa.app.control_charts import Charts

WIDTH = 100


def lines(found: "Charts") -> Iterator[str]:
    """Lay the charts out, one line after another."""
    from cbsr_qa.app.charts_page import chart_words
    from cbsr_qa.report.numbers import plural

    request = found.request
    of = f"golden sensor {request.golden}" if request.golden else "production"
    simulated = " (SIMULATED)" if found.simulated else ""
    yield printable(
        f"station  {request.station}: {plural(found.runs, 'run')} of {of}, recipe {found.recipe}{simulated}"
    )
    signals = found.signals
    charted = sum(one.reference is not None for one in found.charts)
    state = (
        f"OUT OF CONTROL: a signal stands on {len(signals)} of {plural(charted, 'chart')}"
        if signals
        else f"in control on {plural(charted, 'chart')}"
    )
    yield f"state    {state}"
    if found.stored:
        yield f"stored   {plural(charted, 'reference')}"
    for words in found.notes:
        yield from _wrapped("note     ", printable(words))
    for one in found.charts:
        yield ""
        yield printable(one.label)
        for words in chart_words(one):
            yield from _wrapped("    ", printable(words))


def _wrapped(start: str, text: str) -> Iterator[str]:
    indent = " " * len(start) if start.strip() else f"{start}  "
    yield from textwrap.wrap(
        text, WIDTH, initial_indent=start, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
