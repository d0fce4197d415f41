"""What a run's report says of its station's control charts."""

from cbsr_qa.domain.naming import of_kind
from cbsr_qa.domain.report import Block, Paragraph
from cbsr_qa.domain.station_charts import StationCharts
from cbsr_qa.report.numbers import plural


def chart_blocks(charts: StationCharts | None) -> tuple[Block, ...]:
    """Say which charts signal since when and by which rule; nothing where the station has no reference stored."""
    if charts is None:
        return ()
    whole = f"{plural(charts.charts, 'control chart')} of {of_kind('station', charts.station)}"
    if not charts.signals:
        blocks: list[Block] = [Paragraph(f"None of {whole} signals.")]
    else:
        words = f"The station is out of control: {len(charts.signals)} of {whole} signal."
        blocks = [Paragraph(words, "warning")]
        blocks += [Paragraph(f"{signal.words()}.", "warning") for signal in charts.signals]
        blocks.append(
            Paragraph(
                "A signal is about the station, not about this sensor's limits: measure a golden sensor "
                f"(cbsr-qa station check --golden), and see cbsr-qa charts --station {charts.station}.",
                "note",
            )
        )
    return (*blocks, *(Paragraph(f"{note}.", "note") for note in charts.notes))
