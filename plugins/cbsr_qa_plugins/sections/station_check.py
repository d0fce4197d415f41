"""How the station stood when the run was made: its latest check, and its control charts."""

from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.report import RunResult, Section
from cbsr_qa.report.station_charts import chart_blocks
from cbsr_qa.report.station_check import station_blocks


class StationChecked:
    """Section of the station's control charts that signal, and its latest check before the run."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None for a recording."""
        if not isinstance(result, RunResult):
            return None
        identity = result.record.identity
        checked = station_blocks(identity.station, result.station_check, identity.started_at)
        return Section("Station", (*chart_blocks(result.station_charts), *checked))
