"""The store's interface: open a database, journal runs into it, query it."""

from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from functools import cached_property
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self

from sqlalchemy import Engine, func, select

from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.run.gate import GateAnswer
from cbsr_qa.domain.sensor.sensor_type import Material, SensorType
from cbsr_qa.store.chain.links import KEY_OPTION
from cbsr_qa.store.changes import Changes
from cbsr_qa.store.chart_references import ChartReferences
from cbsr_qa.store.damage import address, name_database, translate_errors
from cbsr_qa.store.engine import leave_engine, parse_url, reading, sqlite_file
from cbsr_qa.store.locks import Claims
from cbsr_qa.store.results.analyses import Analyses
from cbsr_qa.store.runs.journal import Journal
from cbsr_qa.store.runs.outcomes import SensorRuns
from cbsr_qa.store.runs.runs import Runs
from cbsr_qa.store.stations import StationChecks
from cbsr_qa.store.tables.records import ChartReferenceRow, ReleaseRow, StationCheckRow, VerdictOverrideRow
from cbsr_qa.store.tables.results import (
    AnalysisRow,
    CalibrationRow,
    CertificateRow,
    CertificateWithdrawalRow,
    ReanalysisRow,
)
from cbsr_qa.store.tables.runs import FrameBlockRow, LoadRow, RunRow, SampleBlockRow, SensorRow
from cbsr_qa.store.types import IdSource, time_of_id
from cbsr_qa.system.clock import write_local_time

if TYPE_CHECKING:
    from cbsr_qa.store.fleet import Fleet
    from cbsr_qa.store.listed import RunLists
    from cbsr_qa.store.releases import Releases
    from cbsr_qa.store.results.calibrations import Calibrations
    from cbsr_qa.store.results.certificates import Certificates
    from cbsr_qa.store.results.reanalyses import Reanalyses
    from cbsr_qa.store.runs.archiving import RunArchives
    from cbsr_qa.store.runs.live import LiveRuns
    from cbsr_qa.store.runs.sessions import UnfinishedRuns
    from cbsr_qa.store.soundness import Soundness
    from cbsr_qa.store.sync.queue import Backlog

#: Least difference between the clocks of computers that share a database at which a warning is given.
_CLOCKS_DIFFER: Final = timedelta(minutes=1)


class Repository:
    """An open database. Made by :func:`open_store`; use it as a context manager, or close it.

    Its attributes give access to the stored data, as in ``repository.runs.load(run)``.

    Parameters
    ----------
    engine : engine of an up-to-date database.
    wall : clock for identifiers, and for the times of analyses and decisions.

    Attributes
    ----------
    runs, unfinished, live : runs by their identifier; those without a result; those that somebody watches.
    sensors, fleet, lists : runs of one sensor; of many, with their values; as a shift lists them.
    claims, archives : runs and sensors that processes work on now; frames outside of the database.
    analyses, reanalyses, calibrations, certificates : results of runs.
    changes : changed files and overridden verdicts.
    stations, charts, releases : checks of stations, references of control charts, released files.
    soundness : damage, and missing data.
    """

    def __init__(self, engine: Engine, wall: Callable[[], datetime]) -> None:
        self._engine = engine
        self._wall = wall
        self._ids = IdSource(wall)
        self.runs = Runs(engine)
        self.sensors = SensorRuns(engine)
        self.claims = Claims(engine)
        self.analyses = Analyses(engine, self.new_id, wall)
        self.changes = Changes(engine, self.new_id, wall)
        self.stations = StationChecks(engine)
        self.charts = ChartReferences(engine)

    # What follows is loaded on first use: a run needs none of it.

    @cached_property
    def unfinished(self) -> "UnfinishedRuns":
        from cbsr_qa.store.runs.sessions import UnfinishedRuns

        return UnfinishedRuns(self._engine)

    @cached_property
    def live(self) -> "LiveRuns":
        from cbsr_qa.store.runs.live import LiveRuns

        return LiveRuns(self._engine)

    @cached_property
    def fleet(self) -> "Fleet":
        from cbsr_qa.store.fleet import Fleet

        return Fleet(self._engine)

    @cached_property
    def lists(self) -> "RunLists":
        from cbsr_qa.store.listed import RunLists

        return RunLists(self._engine)

    @cached_property
    def archives(self) -> "RunArchives":
        from cbsr_qa.store.runs.archiving import RunArchives

        return RunArchives(self._engine)

    @cached_property
    def reanalyses(self) -> "Reanalyses":
        from cbsr_qa.store.results.reanalyses import Reanalyses

        return Reanalyses(self._engine, self.new_id, self._wall)

    @cached_property
    def calibrations(self) -> "Calibrations":
        from cbsr_qa.store.results.calibrations import Calibrations

        return Calibrations(self._engine)

    @cached_property
    def certificates(self) -> "Certificates":
        from cbsr_qa.store.results.certificates import Certificates

        return Certificates(self._engine, self.new_id, self._wall)

    @cached_property
    def releases(self) -> "Releases":
        from cbsr_qa.store.releases import Releases

        return Releases(self._engine)

    @cached_property
    def soundness(self) -> "Soundness":
        from cbsr_qa.store.soundness import Soundness

        return Soundness(self._engine)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        leave_engine(self._engine)

    @property
    def shown(self) -> str:
        """The database, for people; a password is hidden."""
        return name_database(self._engine.url)

    @property
    def address(self) -> str:
        """Value of ``--database``, quoted for a shell; a password is hidden."""
        return address(self._engine.url)

    @property
    def key_id(self) -> str | None:
        """Identifier of the key that signs new links; None if none is set."""
        key = self._engine.get_execution_options().get(KEY_OPTION)
        return None if key is None else str(key.key_id)

    def is_at(self, url: str) -> bool:
        return parse_url(url) == self._engine.url

    def open_journal(
        self,
        *,
        configuration: str,
        sensor_type: SensorType,
        material: Material,
        indenter: Indenter,
        tell: Callable[[str], None] | None = None,
        why: str = "",
        gate: Sequence[GateAnswer] = (),
    ) -> Journal:
        """Return the journal that stores the events of one run, new or resumed; it takes the same parameters."""
        return Journal(
            self._engine,
            configuration=configuration,
            sensor_type=sensor_type,
            material=material,
            indenter=indenter,
            tell=tell,
            why=why,
            gate=gate,
        )

    def new_id(self) -> str:
        """Return a new time-ordered identifier for a run, an analysis or a calibration.

        It sorts after all that are stored, even if the clock was set back.
        """
        self._ids.follow(self._find_latest_id())
        return self._ids.new()

    def describe_clock_fault(self) -> str:
        """Return a warning if the latest stored identifier lies in the clock's future; else empty."""
        latest, now = time_of_id(self._find_latest_id()), self._wall()
        if latest is None or latest - now < _CLOCKS_DIFFER:
            return ""
        return (
            f"{self.shown} holds something made at {write_local_time(latest)}, and this computer's clock says"
            f" {write_local_time(now)}: one of the clocks was wrong, or was set back; the order of runs is kept"
        )

    def _find_latest_id(self) -> str:
        """Return the highest stored identifier; empty without one."""
        columns = (
            RunRow.run,
            AnalysisRow.analysis,
            CalibrationRow.calibration,
            StationCheckRow.check_id,
            ChartReferenceRow.reference,
            VerdictOverrideRow.override_id,
            ReanalysisRow.reanalysis,
            ReleaseRow.release_id,
            CertificateRow.certificate,
            CertificateWithdrawalRow.withdrawal,
        )
        with reading(self._engine) as connection:
            highest_ids = connection.execute(
                select(*(select(func.max(column)).scalar_subquery() for column in columns))
            ).one()
        # Only identifiers with a time count, sorted as text: databases edited by hand may hold others.
        return max(
            (
                identifier
                for identifier in highest_ids
                if identifier is not None and time_of_id(identifier) is not None
            ),
            default="",
        )

    def count_rows(self) -> dict[str, int]:
        """Return how many sensors, runs, frames, samples and loads are stored."""
        counted = {
            "sensors": select(func.count()).select_from(SensorRow),
            "runs": select(func.count()).select_from(RunRow),
            "frames": select(func.coalesce(func.sum(FrameBlockRow.frames), 0)),
            "samples": select(func.coalesce(func.sum(SampleBlockRow.samples), 0)),
            "loads": select(func.count()).select_from(LoadRow),
        }
        with reading(self._engine) as connection:
            return {name: int(connection.scalar(query) or 0) for name, query in counted.items()}

    def measure_size_bytes(self) -> int:
        """Return the size of a database: of a SQLite file with its log, or of a whole PostgreSQL database."""
        file = sqlite_file(self._engine.url)
        if file is not None:
            log = file.with_name(f"{file.name}-wal")
            return file.stat().st_size + (log.stat().st_size if log.exists() else 0)
        with reading(self._engine) as connection:
            return int(connection.exec_driver_sql("SELECT pg_database_size(current_database())").scalar() or 0)

    def shrink(self) -> None:
        """Give the free pages of a SQLite file back to the disk, which needs room for a copy of what remains.

        StoreError if the disk has no room, or another program reads the file; the file is unchanged then.
        """
        if sqlite_file(self._engine.url) is None:
            return
        with translate_errors(self._engine.url):
            connection = self._engine.raw_connection()
            try:
                connection.cursor().execute("VACUUM")
                connection.cursor().execute("PRAGMA wal_checkpoint(TRUNCATE)")
            finally:
                connection.close()

    def read_backlog(self) -> "Backlog":
        """Return the number of items that wait for the central database, and since when."""
        from cbsr_qa.store.sync.queue import backlog

        return backlog(self._engine)

    def name_unread_entries(self) -> tuple[str, ...]:
        """Return in words the rows of the outbox that cannot be read; their items are not sent."""
        from cbsr_qa.store.sync.queue import name_unread

        return name_unread(self._engine)
