"""A fleet for trying comparisons: values of batch + station + sensor + run + place, drawn from a known truth."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path
from typing import Final

import numpy as np

from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.config.merging import Configuration
from cbsr_qa.config.paths import var_folder
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM, Load, LoadRecord
from cbsr_qa.domain.results.measurement import Measurement, decide
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.events import LoadFinished, PhaseFinished, PhaseStarted, RunEnded, RunEvent, RunStarted
from cbsr_qa.domain.run.run import InstrumentIdentity, RunIdentity
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.studies.simulated import configuration_of, copy_shipped

#: Seed of all draws; the first one, not chosen for its result.
SEED: Final = 1

#: Names of the designs, which equal those of their recipes.
ONE_STATION: Final = "each-on-one-station"
THIRD_ON_ALL: Final = "a-third-on-all-stations"
REPEATED: Final = "twice-on-every-station"  # runs for a gauge study
_LETTERS: Final = {ONE_STATION: "S", THIRD_ON_ALL: "T", REPEATED: "G"}

BATCHES: Final = ("41", "42", "43")
STATIONS: Final = ("A", "B", "C")
_SENSORS: Final = 20  # sensors of a batch
_IN_GAUGE_STUDY: Final = 6  # of batch 41, each twice on every station
_AT_HOME: Final = 12  # share of them on the batch's own station: stations and batches are strongly confounded
_EFFECT: Final = 1.5  # in deviations between sensors: difference of batch 43, and of station B

#: Statement in the database, on pages and in reports.
SAID: Final = (
    "figures are drawn from a statistical model of a fleet: nothing was measured, no sheet and no frame was simulated"
)
_PHASE: Final = "nine locations"
_BEGAN: Final = datetime(2026, 3, 2, 7, 0, tzinfo=UTC)
_APART: Final = timedelta(minutes=40)


@dataclass(frozen=True, slots=True)
class Drawn:
    """Parameters of the random values of one metric.

    Parameters
    ----------
    mean : mean of batch 41 on station A, in the unit.
    sensor, run, place : standard deviations between sensors, runs of a sensor, and places of a run (or 0).
    batch, station : offsets of batch 43 and of station B, in deviations between sensors.
    """

    name: str
    unit: str
    mean: float
    sensor: float
    run: float
    place: float
    batch: float
    station: float


DRAWN: Final = (
    Drawn("centre_of_mass_error", "mm", 2.65, 0.4, 0.12, 0.25, _EFFECT, _EFFECT),
    Drawn("area_ratio", "1", 1.3, 0.15, 0.05, 0.1, 0.0, -_EFFECT),
    Drawn("noise_floor", "1", 0.006, 0.0006, 0.0002, 0.0, 0.0, 0.0),
)


@dataclass(frozen=True, slots=True)
class _Run:
    """One run of a design, by numbers."""

    recipe: str
    batch: int
    station: int
    sensor: int

    @property
    def serial(self) -> str:
        return f"{_LETTERS[self.recipe]}{BATCHES[self.batch]}-{self.sensor + 1:02d}"


def fleet_demo_path() -> Path:
    """Return the path of the fleet, a separate database."""
    return var_folder() / "fleet-demo.db"


def build_fleet(count: Callable[[int, int], None] = lambda done, of: None, *, path: Path | None = None) -> Path:
    """Build the fleet, by default in ``fleet-demo.db`` in ``var/``; an earlier one is replaced.

    RefusedError if the path has other content, which is left unchanged.
    """
    path = path or fleet_demo_path()
    path.parent.mkdir(parents=True, exist_ok=True)
    _make_room(path)
    runs = tuple(yield_runs())
    kinds = {(run.recipe, run.station): run for run in runs}
    configurations = {kind: _configuration(run) for kind, run in kinds.items()}
    clock_time = _BEGAN
    # Designs have separate random numbers, so that runs of one do not affect another.
    compared, repeated = np.random.default_rng(SEED), np.random.default_rng([SEED, len(_LETTERS)])
    draws = {ONE_STATION: compared, THIRD_ON_ALL: compared, REPEATED: repeated}
    sensors = {run.serial: draws[run.recipe].standard_normal(len(DRAWN)) for run in runs}
    with open_store(f"sqlite:///{path}", durable=False, wall=lambda: clock_time) as store:
        for done, run in enumerate(runs, start=1):
            clock_time += _APART
            figures = _figures(run, sensors[run.serial], draws[run.recipe])
            _store(store, run, configurations[run.recipe, run.station], figures, clock_time)
            count(done, len(runs))
    return path


def yield_runs() -> Iterator[_Run]:
    """Yield the runs of all designs in order of time: batch after batch, sensor after sensor.

    Twelve of a batch's twenty sensors are at its own station, four at each other one. In the second design every
    third sensor is run on all stations. In the third, six sensors of one batch are run twice on every station.
    """
    for recipe in (ONE_STATION, THIRD_ON_ALL):
        for batch in range(len(BATCHES)):
            homes = [batch] * _AT_HOME + [(batch + 1 + k % 2) % len(STATIONS) for k in range(_SENSORS - _AT_HOME)]
            for sensor in range(_SENSORS):
                home = homes[3 * sensor % _SENSORS]
                everywhere = recipe == THIRD_ON_ALL and sensor % 3 == 0
                for station in range(len(STATIONS)) if everywhere else (home,):
                    yield _Run(recipe, batch, station, sensor)
    for _ in range(2):
        for station in range(len(STATIONS)):
            for sensor in range(_IN_GAUGE_STUDY):
                yield _Run(REPEATED, 0, station, sensor)


def _make_room(path: Path) -> None:
    """Remove an earlier fleet; refuse if the path has other content."""
    if not path.exists():
        return
    with open_store(f"sqlite:///{path}", create=False) as store:
        strange = [run.run for run in store.runs.find() if run.recipe not in _LETTERS]
    if strange:
        raise RefusedError(
            f"{path} holds runs that are not of the demonstration, e.g. {strange[0]}",
            remedy="move that file away, or set CBSR_QA_VAR to another folder",
        )
    for suffix in ("", "-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def _figures(run: _Run, sensor: np.ndarray, random: np.random.Generator) -> dict[str, np.ndarray]:
    """Draw the values of one run: (places,) of each metric, or (1,)."""
    figures = {}
    for metric, deviation in zip(DRAWN, sensor, strict=True):
        systematic = metric.batch * (BATCHES[run.batch] == "43") + metric.station * (STATIONS[run.station] == "B")
        level = metric.mean + metric.sensor * (systematic + deviation) + metric.run * random.standard_normal()
        figures[metric.name] = level + metric.place * random.standard_normal(9 if metric.place else 1)
    return figures


def _configuration(run: _Run) -> Configuration:
    """The shipped files the figures would be of, with limits on what is drawn alone."""
    station, recipe = (
        copy_shipped(DocumentKind.STATION, "simulated"),
        copy_shipped(DocumentKind.RECIPE, "nine-locations"),
    )
    station["station"]["name"] = f"station-{STATIONS[run.station]}"
    recipe["recipe"] = {"name": run.recipe, "calibrate_phases": []}
    recipe["phases"] = [phase for phase in recipe["phases"] if phase["name"] == _PHASE]
    del recipe["failure_codes"]  # most are of limits that are left out
    names = [metric.name for metric in DRAWN]
    recipe["limits"] = [
        limit for limit in recipe["limits"] if limit["measurement"] in names and limit.get("phase", _PHASE) == _PHASE
    ]
    return configuration_of(station, recipe, seed=SEED)


def _store(
    store: Repository, run: _Run, configuration: Configuration, figures: dict[str, np.ndarray], now: datetime
) -> None:
    """Store one run with its presses and its verdict, as a station would, but without frames."""
    identity = RunIdentity(
        run=store.new_id(),
        sensor=SensorIdentity(run.serial, BATCHES[run.batch], configuration.sensor_type.name),
        station=configuration.station.name,
        recipe=run.recipe,
        operator="",
        started_at=now,
        configuration_digest=configuration.digest,
        software=(("cbsr-qa", version("cbsr-qa")),),
        instruments=(InstrumentIdentity("bench", "none", "statistical model", "", "", True),),
        simulated=(SAID,),
    )
    journal = store.open_journal(
        configuration=configuration.canonical,
        sensor_type=configuration.sensor_type,
        material=configuration.material,
        indenter=configuration.station.indenter,
    )
    for document in _documents(identity):
        journal(document)
    measurements = _measurements(figures, configuration)
    result = RunResult(
        record=store.runs.load(identity.run),
        observation=None,
        measurements=measurements,
        verdict=decide(measurements),
        calibration=None,
        calibration_why=SAID,
        warnings=(SAID,),
    )
    store.analyses.save(result)


def _documents(identity: RunIdentity) -> Iterator[RunEvent]:
    yield RunStarted(identity)
    yield PhaseStarted(0, _PHASE, "location-grid", 0.0, Role.GRID)
    for number, (x_mm, y_mm) in enumerate(NINE_LOCATIONS_MM):
        begun_s = 120.0 * number
        load = Load(f"L{number}", x_mm, y_mm, 0.2, 0)
        down_s, up_s = begun_s + 1.0, begun_s + 61.0
        yield LoadFinished(0, LoadRecord(number, load, begun_s, down_s, up_s, up_s + 1.0, begun_s + 120.0))
    yield PhaseFinished(0, 1080.0)
    yield RunEnded(EndReason.FINISHED, "", 1080.0, ())


def _measurements(figures: dict[str, np.ndarray], configuration: Configuration) -> tuple[Measurement, ...]:
    limits = {limit.measurement: limit for limit in configuration.recipe.limits}
    measurements = []
    for metric in DRAWN:
        for number, value in enumerate(figures[metric.name]):
            measurement = Measurement(metric.name, float(value), metric.unit, how="drawn from a statistical model")
            if metric.place:
                measurement = replace(
                    measurement, phase=_PHASE, location=f"L{number}", trial=0, load=number, strain=0.2
                )
            measurements.append(measurement.judge(limits[metric.name]))
    return tuple(measurements)
