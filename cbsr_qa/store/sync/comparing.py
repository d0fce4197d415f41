"""What was sent before, compared at both ends: rows with their links, and the order in which runs were begun."""

from collections.abc import Collection, Mapping
from datetime import date
from typing import Final

from sqlalchemy import Engine, select

from cbsr_qa.domain import StoreError
from cbsr_qa.domain.results import RunSelection
from cbsr_qa.store.archives import archive_row
from cbsr_qa.store.chain import ALL_KINDS, check_run
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.listed import run_names
from cbsr_qa.store.outbox import Kind, announce
from cbsr_qa.store.runs import begun
from cbsr_qa.store.soundness import check_stored_run
from cbsr_qa.store.sync.parcels import AlteredError
from cbsr_qa.store.tables import OutboxRow, RunRow

#: Identifiers asked for at once.
_AT_ONCE: Final = 500


def compare_run(station: Engine, centre: Engine, run: str) -> None:
    """Check that rows of a run still match their links at both ends, and at the station its frames and files.

    Whether both ends have the same links shows in the last one that both have, which the sender compares.

    Raises
    ------
    AlteredError
        Naming table and row, and the centre if it is there.
    """
    with reading(station) as connection:
        archived = archive_row(connection, run) is not None
    try:
        check_stored_run(station, run, frames=not archived)
    except StoreError as error:
        raise AlteredError(error.reason) from error
    try:
        with reading(centre) as connection:
            check_run(connection, run, ALL_KINDS)  # the station need not reach the centre's archives
    except StoreError as error:
        raise AlteredError(f"at the centre, {error.reason}") from error


def announce_since(station: Engine, day: date) -> None:
    """Announce every run from a day on (UTC), so that the centre is compared with it, and gets what it lacks."""
    _announce_unannounced(station, run_names(station, RunSelection(since=day)))


def announce_missing(station: Engine) -> Mapping[str, begun.Gap]:
    """Return the runs that are missing in a station's database, and have them in its outbox: its operator decides."""
    with reading(station) as connection:
        missing = {gap.run: gap for gap in begun.gaps(connection) if not gap.refused}
    _announce_unannounced(station, missing)
    return missing


def _announce_unannounced(station: Engine, runs: Collection[str]) -> None:
    with writing(station) as connection:
        row = OutboxRow
        there = set(connection.scalars(select(row.item).where(row.kind == str(Kind.RUN))))
        announce(connection, Kind.RUN, [run for run in runs if run not in there])


def other_runs_at_centre(station: Engine, centre: Engine, runs: Collection[str]) -> tuple[str, ...]:
    """Return in words which runs the centre has that follow those of a station's database, and are not in it.

    Parameters
    ----------
    runs : that were sent now; the latest run of the database is looked at too.
    """
    with reading(station) as ours, reading(centre) as theirs:
        before = set(ours.scalars(select(RunRow.before_run).where(RunRow.run.in_(list(runs)[-_AT_ONCE:]))))
        before |= {begun.latest_begun(ours)}
        followers = select(RunRow.run, RunRow.before_run).where(RunRow.before_run.in_(before - {None}))
        found = theirs.execute(followers.order_by(RunRow.run)).all()
        here = set(ours.scalars(select(RunRow.run).where(RunRow.run.in_([row.run for row in found]))))
    return tuple(
        f"the centre has run {begun.named_run(row.run)}, which follows run {row.before_run} and is not in this"
        " database: it was removed here, or this is a copy or an older state of the database that it was begun in"
        for row in found
        if row.run not in here
    )
