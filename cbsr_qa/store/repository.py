"""The store's front door: open a database, journal runs into it, ask it about them."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from datetime import datetime, timedelta
from types import TracebackType
from typing import Final, Self

from sqlalchemy import Engine

from cbsr_qa.domain.results import (
    Calibration,
    FleetTable,
    LinearReconstruction,
    Outcome,
    RunLine,
    RunResult,
    RunSelection,
)
from cbsr_qa.domain.run import (
    ChangeHistory,
    ChartReference,
    ConfigurationChange,
    Indenter,
    RingReadings,
    RunIdentity,
    RunRecord,
    RunSession,
    SensorHistory,
    StationCheck,
    VerdictOverride,
)
from cbsr_qa.domain.sensor import Material, SensorIdentity, SensorType
from cbsr_qa.store import (
    changes,
    changes as overrides,
    fleet as fleet_query,
    locks,
    stations as chart_references,
    stations as station_checks,
)
from cbsr_qa.store.engine import address, look_afresh, parsed_url, shown
from cbsr_qa.store.results import (
    CalibrationSummary,
    PrepareForce,
    StoredAnalysis,
    analyses,
    calibrations,
    calibrations_of_before,
)
from cbsr_qa.store.runs import (
    IncompleteRun,
    Journal,
    RunSummary,
    latest_id,
    outcomes,
    runs,
    sessions as incomplete,
)
from cbsr_qa.store.types import IdSource, made_at

#: Clocks of computers that share a database may differ by this much without anybody being told.
_CLOCKS_DIFFER: Final = timedelta(minutes=1)
_EVERY: Final = RunSelection()


class Repository:
    """An open database. Made by :func:`open_store`; use it as a context manager, or close it."""

    def __init__(self, engine: Engine, wall: Callable[[], datetime]) -> None:
        self._engine = engine
        self._wall = wall
        self._ids = IdSource(wall)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the connections back."""
        self._engine.dispose()

    @property
    def shown(self) -> str:
        """What database this is, for people; a password is hidden."""
        return shown(self._engine.url)

    @property
    def address(self) -> str:
        """What ``--database`` takes, as a shell reads it; a password is hidden."""
        return address(self._engine.url)

    def is_at(self, url: str) -> bool:
        """Whether a URL means this database."""
        return parsed_url(url) == self._engine.url

    def new_id(self) -> str:
        """Return a new time-ordered identifier for a run, an analysis or a calibration.

        It comes after all that are stored, also where the clock was set back: the latest was made last.
        """
        self._ids.follow(latest_id(self._engine))
        return self._ids.new()

    def from_the_future(self) -> str:
        """Return in words that the latest thing stored is from later than the clock says; empty where it is not."""
        latest, now = made_at(latest_id(self._engine)), self._wall()
        if latest is None or latest - now < _CLOCKS_DIFFER:
            return ""
        return (
            f"{self.shown} holds something made at {latest:%Y-%m-%d %H:%M} UTC, and this computer's clock says"
            f" {now:%Y-%m-%d %H:%M}: one of the clocks was wrong, or was set back; the order of runs is kept"
        )

    def journal(
        self,
        *,
        configuration: str,
        sensor_type: SensorType,
        material: Material,
        indenter: Indenter,
        tell: Callable[[str], None] | None = None,
        why: str = "",
    ) -> Journal:
        """Return the journal of one session: call it with every document of the run.

        ``tell`` is told while another program's writing is waited for; ``why`` is noted with changes of its files.
        """
        return Journal(
            self._engine,
            configuration=configuration,
            sensor_type=sensor_type,
            material=material,
            indenter=indenter,
            tell=tell,
            why=why,
        )

    def writing_alone(self, run: str, operator: str = "") -> AbstractContextManager[None]:
        """Hold the right to write a run while entered; StoreError naming who does, where another process does."""
        return locks.writing_alone(self._engine, run, locks.this_process(operator))

    @contextmanager
    def seed_claimed(self, serial: str, seed: int, operator: str = "") -> Iterator[bool]:
        """Claim a seed for a run of a sensor while entered; yields False where another run of it has the seed."""
        with locks.seed_claimed(self._engine, serial, seed, locks.this_process(operator)) as claimed:
            yield claimed and seed not in self.seeds_of(serial)

    def seeds_of(self, serial: str) -> tuple[int | None, ...]:
        """Return the seeds of all runs of a sensor, oldest first; None where a configuration states none."""
        return outcomes.seeds_of(self._engine, serial)

    def writer_of(self, run: str) -> str:
        """Return who writes a run at this moment; empty where nobody does."""
        return locks.writer_of(self._engine, run)

    def load_run(self, run: str) -> RunRecord:
        """Load a run with every frame, digests checked. StoreError if it is not there or not what was measured."""
        return runs.load_run(self._engine, run)

    def identity(self, run: str) -> RunIdentity:
        """Return what traces a run, without its frames. StoreError if it is not there."""
        return runs.identity(self._engine, run)

    def configuration(self, run: str) -> str:
        """Return the canonical JSON a run was configured with."""
        return runs.configuration_of(self._engine, run)

    def whole_run(self, run: str) -> RunRecord:
        """Load a run afresh, the whole database file checked. StoreError where something is damaged."""
        return runs.whole_run(self._engine, run)

    def check_resumable(self, run: str) -> None:
        """Check all that is stored of a run, and that it can be added to. StoreError where not."""
        runs.check_resumable(self._engine, run)

    def finished_loads(self, run: str) -> frozenset[tuple[int, int]]:
        """Return (phase, index) of the presses of a run that were held to their end."""
        return runs.finished_loads(self._engine, run)

    def ended_phases(self, run: str) -> frozenset[int]:
        """Return the phases of a run whose last step was carried out."""
        return runs.ended_phases(self._engine, run)

    def state_of(self, run: str) -> RunSession:
        """Return the latest session of a run: how it stands. StoreError if there is no such run."""
        return runs.state_of(self._engine, run)

    def goes_on_at_s(self, run: str) -> float:
        """Return when on the run's time line a resumed session begins [s]."""
        return runs.goes_on_at_s(self._engine, run)

    def find_runs(self, serial: str | None = None) -> tuple[RunSummary, ...]:
        """Return runs, the latest first: of one sensor, or all."""
        return runs.find_runs(self._engine, serial)

    def sensor_history(self, sensor: SensorIdentity, recipe: str, before: str = "") -> SensorHistory:
        """Return the runs of a sensor that began before a run (empty: all), as seen from a run of this recipe."""
        return SensorHistory(sensor, recipe, outcomes.earlier_runs(self._engine, sensor.serial, before))

    def resolve(self, run_or_serial: str) -> str:
        """Return the run meant: itself, or the latest of a sensor. StoreError if it is neither."""
        return runs.resolve(self._engine, run_or_serial)

    def incomplete_runs(self) -> tuple[IncompleteRun, ...]:
        """Return runs that did not finish, oldest first: under way, cut off, aborted or broken."""
        return incomplete.incomplete_runs(self._engine)

    def counts(self) -> dict[str, int]:
        """Return how much is stored, by kind."""
        return incomplete.counts(self._engine)

    def save_result(self, result: RunResult, *, software: Sequence[tuple[str, str]] | None = None) -> str:
        """Store what was concluded from a run, its calibration included, in one transaction, and read it back.

        Parameters
        ----------
        software : versions it was analysed with; by default those the run was made with.

        Returns
        -------
        Identifier of the new analysis; earlier ones stay.

        Raises
        ------
        StoreError
            If the run is not what was stored, or what was stored of the analysis cannot be read back.
        """
        look_afresh(self._engine)
        analysis = self.new_id()
        versions = result.record.identity.software if software is None else software
        analyses.save_result(
            self._engine, result, analysis=analysis, analysed_at=self._wall(), software=tuple(versions)
        )
        look_afresh(self._engine)
        self.analyses(result.record.identity.run)
        return analysis

    def analyses(self, run: str) -> tuple[StoredAnalysis, ...]:
        """Return every analysis of a run, the latest first: the first is the one that holds."""
        return analyses.analyses_of(self._engine, run)

    def changes(self) -> tuple[ConfigurationChange, ...]:
        """Return every change of a file that runs were configured by, oldest first."""
        return changes.all_changes(self._engine)

    def change_history(self, record: RunRecord) -> ChangeHistory:
        """Return the changes of a run's files since its sensor type last passed its recipe."""
        return changes.history_of(self._engine, record.identity, record.material.name)

    def override_verdict(self, run: str, outcome: Outcome, *, operator: str, why: str) -> VerdictOverride:
        """Store a decision against the verdict of a run, beside it. StoreError where the run has no verdict."""
        return overrides.save_override(
            self._engine,
            run,
            outcome,
            override=self.new_id(),
            operator=operator,
            why=why,
            noted_at=self._wall(),
        )

    def overrides(self, run: str | None = None) -> tuple[VerdictOverride, ...]:
        """Return the overrides of one run's verdicts, or of all, oldest first."""
        return overrides.overrides(self._engine, run)

    def run_lines(self, selection: RunSelection = _EVERY) -> tuple[RunLine, ...]:
        """Return the selected runs in the order they were made in."""
        return fleet_query.run_lines(self._engine, selection)

    def fleet(self, selection: RunSelection = _EVERY) -> FleetTable:
        """Return the selected runs with the values of their latest analyses."""
        return fleet_query.fleet_table(self._engine, selection)

    def save_chart_references(self, references: Sequence[ChartReference]) -> None:
        """Store references of control charts beside the earlier ones."""
        chart_references.save_references(self._engine, references)

    def chart_references(self, station: str, until: str = "") -> tuple[ChartReference, ...]:
        """Return the references that hold of a station's charts (until something of a later name was made)."""
        return chart_references.current_references(self._engine, station, until)

    def all_chart_references(self, station: str = "") -> tuple[ChartReference, ...]:
        """Return every reference the charts of a station (empty: of all) ever had, oldest first."""
        return chart_references.all_references(self._engine, station)

    def save_station_check(self, check: StationCheck, ring: RingReadings | None = None) -> None:
        """Store a check of a station, with the frames of its reference ring where there are some."""
        station_checks.save_check(self._engine, check, ring)

    def latest_station_check(self, station: str, before: datetime | None = None) -> StationCheck | None:
        """Return the latest check of a station (until a moment), or None where it was never checked."""
        return station_checks.latest_check(self._engine, station, before)

    def station_check_ring(self, check: str) -> RingReadings | None:
        """Return the ring's frames of a check, digest checked; None where no ring was measured."""
        return station_checks.ring_of(self._engine, check)

    def calibrations(self, serial: str) -> tuple[CalibrationSummary, ...]:
        """Return a sensor's calibrations, the latest first."""
        return calibrations.calibrations_of(self._engine, serial)

    def calibration_file(self, calibration: str) -> tuple[bytes, str] | None:
        """Return a calibration's file as it was issued, and its digest; None where it was stored as rows."""
        return calibrations.calibration_file(self._engine, calibration)

    def calibration_of_before(
        self, calibration: str, reconstruction: LinearReconstruction | None, prepare_force: PrepareForce
    ) -> Calibration | None:
        """Put a calibration together from its rows, given its matrix; without one the rows are checked alone."""
        return calibrations_of_before.load_calibration_of_before(
            self._engine, calibration, reconstruction, prepare_force
        )
