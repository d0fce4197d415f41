"""The design of a comparison: which runs cross which groups and stations."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain.fleet import FleetRun
from cbsr_qa.fleet.groups import Grouping
from cbsr_qa.fleet.terms import By
from cbsr_qa.stats.crossing import Crossing, IntArray, crossing

#: What a run without a batch is of.
NO_BATCH: Final = "batch not stated"


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """The crossing of the runs that count, which they are, and the stations to compare, that with most runs first."""

    crossing: Crossing
    rows: IntArray
    of_stations: bool
    stations: tuple[str, ...]


def design_of(runs: Sequence[FleetRun], grouping: Grouping, by: By) -> Design:
    """Cross the runs that count."""
    rows, of_stations = np.flatnonzero(grouping.used), by is By.STATION
    members = [runs[row] for row in rows.tolist()]
    # Where stations are compared, what must not be taken for one is the batch.
    batches, labels = [run.batch or NO_BATCH for run in members], [grouping.labels[row] for row in rows.tolist()]
    made = crossing(
        batches if of_stations else labels, [run.station for run in members], [run.serial for run in members]
    )
    return Design(made, rows, of_stations, () if of_stations else _by_runs(made))


def _by_runs(made: Crossing) -> tuple[str, ...]:
    """Stations, that with most runs first; none where there is nothing to compare."""
    if len(made.stations) < 2:
        return ()
    return tuple(made.stations[index] for index in np.argsort(-np.bincount(made.station), kind="stable"))
