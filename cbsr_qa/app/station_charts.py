"""State of a station's charts after a run."""

from collections.abc import Sequence

from cbsr_qa.domain.results.charts import StationCharts
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.run.run import RunIdentity
from cbsr_qa.store.repository import Repository


def charts_after(
    store: Repository,
    station: str,
    identity: RunIdentity | None = None,
    measurements: Sequence[Measurement] = (),
    *,
    until: str = "",
) -> StationCharts | None:
    """Return the state of all charts of a station, for any recipe and metric.

    Parameters
    ----------
    identity, measurements : identity and measurements of a run of which no analysis is stored yet, to be charted too.
    until : leave out references and runs later than this identifier, e.g. of an analysis.

    Returns
    -------
    None if no reference is stored for the station.
    """
    references = store.charts.read_current(station, until)
    if not references:
        return None
    from cbsr_qa.app.chart_signals import find_chart_signals  # loads what few stations need

    return find_chart_signals(store, station, references, identity, measurements, until=until)
