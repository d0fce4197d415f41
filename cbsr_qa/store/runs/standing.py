"""What has come of a run: judged by its sessions and its analyses together, in one place.

A run that was stopped has an analysis, "not measured". Once the run is resumed, that analysis is outdated: it says
nothing about the run any more, and the result is missing until the run is analysed after its last session.
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

from sqlalchemy import Connection, TextClause, select, text

from cbsr_qa.domain.run.states import EndReason, ResultState
from cbsr_qa.store.runs.rows import current_state
from cbsr_qa.store.tables.records import FEW_LINKS
from cbsr_qa.store.tables.results import AnalysisRow

#: Links give the order of what was stored. Of a run whose links were removed, the clock has to do,
#: and a stopped session leaves no measurement. The first session has states 0 and 1, and no analysis before them.
_OUTDATED: Final = f"""EXISTS (
    SELECT 1 FROM run_states AS later
    LEFT JOIN run_links AS of_state
        ON of_state.run = later.run AND of_state.kind = 'run_states'
        AND of_state.document = CAST(later.number AS TEXT) AND of_state.{FEW_LINKS}
    LEFT JOIN run_links AS of_analysis
        ON of_analysis.run = later.run AND of_analysis.kind = 'analyses'
        AND of_analysis.document = {{analyses}}.analysis AND of_analysis.{FEW_LINKS}
    WHERE later.run = {{analyses}}.run AND later.number > 1 AND COALESCE(
        of_state.number > of_analysis.number,
        later.noted_at > {{analyses}}.analysed_at AND NOT EXISTS (
            SELECT 1 FROM measurements AS taken WHERE taken.analysis = {{analyses}}.analysis
        )
    )
)"""


def up_to_date_sql(analyses: str) -> str:
    """Return the SQL condition that no session of its run began or ended after an analysis.

    Parameters
    ----------
    analyses : name of the table of analyses in the query.
    """
    return f"NOT {_OUTDATED.format(analyses=analyses)}"


def up_to_date() -> TextClause:
    """Return the condition on rows of analyses that no session of their run began or ended after them."""
    return text(up_to_date_sql(AnalysisRow.__tablename__))


@dataclass(frozen=True, slots=True)
class Standing:
    """How a run's last session ended, and the latest analysis that was stored after it; None without one."""

    end: EndReason
    analysis: str | None

    @property
    def result(self) -> ResultState:
        return ResultState.from_end(self.end, analysed=self.analysis is not None)


def standing_of(connection: Connection, run: str) -> Standing:
    """Return what has come of a stored run. StoreError if it does not exist, or its last state is damaged."""
    end = EndReason(current_state(connection, run).end)
    analyses = select(AnalysisRow.analysis).where(AnalysisRow.run == run, up_to_date())
    return Standing(end, connection.scalar(analyses.order_by(AnalysisRow.analysis.desc()).limit(1)))


def find_outdated(connection: Connection, runs: Collection[str]) -> set[str]:
    """Return the analyses of some runs after which a session of their run began or ended."""
    if not runs:
        return set()
    outdated = text(_OUTDATED.format(analyses=AnalysisRow.__tablename__))
    return set(connection.scalars(select(AnalysisRow.analysis).where(AnalysisRow.run.in_(runs), outdated)))
