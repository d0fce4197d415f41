"""How the station stood when the run was made."""

from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.report import RunResult, Section
from cbsr_qa.report.station_check import station_blocks


class StationChecked:
    """Section of the station's latest check before the run: its age and what failed; or that there was none."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None for a recording."""
        if not isinstance(result, RunResult):
            return None
        identity = result.record.identity
        return Section("Station", station_blocks(identity.station, result.station_check, identity.started_at))
