"""What a station and a list wait for among 100 000 runs: ``python -m benchmarks.many_runs``.

Fills a database on SQLite, and on PostgreSQL where a server answers, with runs of 20 measurements each, all waiting
to be sent to a centre. Prints the fastest and the median repeat of each part of what begins a run and lists a
shift, as other work on the machine slows some of them, and time and memory of ``cbsr-qa compare``.
"""

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from statistics import median
from typing import Final

from sqlalchemy import create_engine, text
from sqlalchemy.exc import OperationalError

from benchmarks.fleet_comparison import fill, timed
from cbsr_qa.app.gate.gate import ask_gate
from cbsr_qa.app.gate.request import GateRequest
from cbsr_qa.app.shift.lists import list_request, list_runs, list_sensors, sensor_runs
from cbsr_qa.app.shift.sensors import search_sensors
from cbsr_qa.config.merging import Configuration
from cbsr_qa.config.serials import validate_serial
from cbsr_qa.domain.plan.gate import GateCheck, GatePolicy, GateSettings, Operator
from cbsr_qa.domain.results.charts import ChartReference
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.run.events import RunStarted
from cbsr_qa.domain.run.run import RunIdentity
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult, StationCheck
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.software import software_versions
from cbsr_qa.station.setup import configure
from cbsr_qa.store import engine as engines
from cbsr_qa.store.engine import open_engine, parse_url, writing
from cbsr_qa.store.opening import check_usable, open_existing, open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.web.gate import gate_view, read_latest
from cbsr_qa.web.start import StartForm
from cbsr_qa.web.stations import ServedStation, load_stations

_SERVER: Final = "postgresql+psycopg://postgres@127.0.0.1:5432/postgres"
_NAME: Final = "cbsr_qa_benchmark_many"
_STATION: Final = "A"
_REPEATS: Final = 20
_LIMIT_S: Final = 0.1

Steps = Mapping[str, Callable[[], object]]


class Line:
    """A station of the fleet with every check of its gate on, and its database."""

    def __init__(self, url: str, folder: Path, plugins: Plugins) -> None:
        self.url, self.plugins, self._folder = url, plugins, folder
        settings = GateSettings(
            dict.fromkeys(GateCheck, GatePolicy.WARN),
            retest_runs=3,
            golden_hours=12.0,
            golden_runs=50,
            operators=(Operator("Ada"),),
        )
        self._served = _serve_station(folder, settings)
        made = configure("simulated", "nine-locations", sensor_type=None, material=None, seed=1)
        self.configuration: Configuration = replace(made, station=replace(made.station, name=_STATION, gate=settings))
        self._runs = 0

    def gate(self) -> None:
        request = GateRequest(self._serial(), self.url, (self._folder,), operator="Ada")
        with open_store(self.url, create=False) as store:
            ask_gate(request, self.configuration, self.plugins, store)

    def check(self, check: GateCheck) -> None:
        request = GateRequest(self._serial(), self.url, (self._folder,), operator="Ada")
        with open_store(self.url, create=False) as store:
            ask_gate(request, self.configuration, self.plugins, store, [check])

    def scan(self, serial: str) -> None:
        """Everything that the page of a line asks when a sensor is scanned."""
        form = {"serial": serial, "operator": "Ada", "batch": "41"}
        read_latest(self.url, serial)
        gate_view(self._served, StartForm.from_form(self._served, form), self.url)

    def start(self) -> None:
        """Everything that ``cbsr-qa run`` asks and writes from the first look at the database to the first row."""
        self._runs += 1
        serial = self._serial()
        engines._engine_of_server.cache_clear()  # a run is a process of its own, which knows no server yet
        check_usable(self.url)
        with open_existing(self.url) or nullcontext() as earlier:
            if earlier is not None:
                earlier.sensors.list_seeds(serial)
        with (
            open_store(self.url, durable=False) as store,
            store.sensors.claim_seed(serial, self._runs, "Ada"),
            store.claims.claim_sensor(serial, "nine-locations", "Ada"),
        ):
            identity = self._identity(store.new_id(), serial)
            sensor = self.configuration
            with store.claims.hold_run(identity.run, "Ada"):
                journal = store.open_journal(
                    configuration=sensor.canonical,
                    sensor_type=sensor.sensor_type,
                    material=sensor.material,
                    indenter=sensor.station.indenter,
                )
                journal(RunStarted(identity))

    def _identity(self, run: str, serial: str) -> RunIdentity:
        return RunIdentity(
            run=run,
            sensor=SensorIdentity(serial, "41", "disc-100mm"),
            station=_STATION,
            recipe="nine-locations",
            operator="Ada",
            started_at=datetime.now(UTC),
            configuration_digest=self.configuration.digest,
            software=software_versions(self.plugins),
            instruments=(),
            simulated=("all",),
        )

    def _serial(self) -> str:
        return validate_serial(f"S-{50_000 + self._runs:05d}")

    def steps(self, latest: str, day: datetime) -> Steps:
        """What is timed, by what is said of it."""
        shift = RunSelection(from_moment=day, before_moment=day + timedelta(days=1))
        own = replace(shift, stations=(_STATION,))
        return {
            "open the database": lambda: open_store(self.url, create=False).close(),
            "list the latest 50 runs": lambda: self._listed(list_runs, latest=50),
            "list the runs of a day": lambda: self._read(lambda store: store.lists.read_runs(shift)),
            "list the runs of a day and station": lambda: self._read(lambda store: store.lists.read_runs(own)),
            "list the latest 50 sensors of a day": lambda: self._listed(
                list_sensors, latest=50, since=day.date(), until=day.date()
            ),
            "list the runs of a sensor": lambda: self._read(lambda store: sensor_runs(store, "S-00001")),
            "search for a sensor": lambda: self._read(lambda store: search_sensors(store, "S-00001")),
            "open a run": lambda: self._read(
                lambda store: (store.runs.read_identity(latest), store.analyses.load(latest))
            ),
            "all checks of the gate": self.gate,
            **{f"gate: {check}": lambda check=check: self.check(check) for check in GateCheck},  # type: ignore[misc]
            "scan a sensor that was never tested": lambda: self.scan("NEW-1"),
            "scan a sensor that was tested": lambda: self.scan("S-00001"),
            "start a run, to its first row": self.start,
        }

    def _read(self, read: Callable[[Repository], object]) -> object:
        with open_store(self.url, create=False) as store:
            return read(store)

    def _listed(self, listing: Callable[..., object], **which: object) -> object:
        return self._read(lambda store: listing(store, list_request(**which)))  # type: ignore[arg-type]


def _serve_station(folder: Path, settings: GateSettings) -> ServedStation:
    """Return the simulated station with these policies, as a page serves it from its file."""
    shipped = (Path(__file__).parents[1] / "stations" / "simulated.toml").read_text(encoding="utf-8")
    checks = "\n".join(f'{check} = "{policy}"' for check, policy in settings.policies.items())
    counts = "retest_runs = 3\ngolden_hours = 12.0\ngolden_runs = 50"
    sync = '[sync]\ncentre = "sqlite:///centre.db"\nbacklog_hours = 24.0'
    named = shipped.replace('name = "simulated"', f'name = "{_STATION}"')
    file = folder / "station.toml"
    gate = f'[gate]\n{checks}\n{counts}\n[[gate.operators]]\nname = "Ada"'
    file.write_text(f"{named}\n{sync}\n{gate}\n", encoding="utf-8")
    (served,) = load_stations([str(file)], ["nine-locations"])
    return served


def prepare(url: str) -> tuple[str, datetime]:
    """Add what a gate asks for: a golden sensor, control charts, an outbox; return the latest run and its day."""
    with open_store(url) as store:
        runs = store.lists.read_names(RunSelection(stations=(_STATION,)))
        latest = store.runs.read_identity(runs[-1]) if runs else None
        if latest is not None and store.stations.read_latest_golden_check(_STATION) is None:
            _equip(store, runs)
            engine = open_engine(parse_url(url), durable=False)
            with writing(engine) as connection:
                connection.execute(
                    text(
                        "INSERT INTO outbox (kind, item, version, sent, noted_at, state, why)"
                        " SELECT 'run', run, 1, 0, CURRENT_TIMESTAMP, 'waiting', '' FROM runs"
                        " WHERE run NOT IN (SELECT item FROM outbox)"
                    )
                )
                if connection.dialect.name == "postgresql":  # as its autovacuum does, which some servers switch off
                    connection.execute(text("ANALYZE"))
            engine.dispose()
    if latest is None:
        return "", datetime.now(UTC)
    return latest.run, latest.started_at.replace(hour=0, minute=0)


def _equip(store: Repository, runs: tuple[str, ...]) -> None:
    check = StationCheck(
        check=store.new_id(),
        station=_STATION,
        operator="Ada",
        checked_at=datetime.now(UTC) - timedelta(hours=1),
        sensor_type="disc-100mm",
        configuration_digest="",
        software=(),
        instruments=(),
        results=(CheckResult("its own mean", CheckOutcome.OK, subject="golden sensor S-7"),),
        golden_run=runs[-40],
    )
    store.stations.save_check(check)
    period = {"runs": 30, "first_run": runs[-130], "last_run": runs[-100], "made_at": datetime.now(UTC)}
    store.charts.save(
        [
            ChartReference(
                reference=store.new_id(),
                station=_STATION,
                recipe="nine-locations",
                golden=None,
                name=f"metric_{number:02d}",
                unit="mm",
                mean=10.0,
                deviation=1.5,
                operator="Ada",
                why="",
                **period,  # type: ignore[arg-type]
            )
            for number in range(2, 4)
        ]
    )


def times_s(step: Callable[[], object]) -> tuple[float, float]:
    """Fastest and median repeat but the first, which imports modules and fills caches [s]."""
    step()
    times = []
    for _ in range(_REPEATS):
        before = time.perf_counter()
        step()
        times.append(time.perf_counter() - before)
    return min(times), median(times)


@contextmanager
def _databases(folder: str, given: str) -> Iterator[dict[str, str]]:
    """URLs by what they are; those of the server are removed afterwards."""
    if given:
        yield {"the database": given}
        return
    urls = {"SQLite": f"sqlite:///{folder}/many.db"}
    server = create_engine(_SERVER, isolation_level="AUTOCOMMIT", connect_args={"connect_timeout": 3})
    try:
        with server.connect() as connection:
            connection.exec_driver_sql(f"DROP DATABASE IF EXISTS {_NAME} WITH (FORCE)")
            connection.exec_driver_sql(f"CREATE DATABASE {_NAME}")
            urls["PostgreSQL"] = f"postgresql://postgres@127.0.0.1:5432/{_NAME}"
    except OperationalError:
        print("no PostgreSQL answers at 127.0.0.1:5432")
    try:
        yield urls
    finally:
        if len(urls) > 1:
            with server.connect() as connection:
                connection.exec_driver_sql(f"DROP DATABASE IF EXISTS {_NAME} WITH (FORCE)")
        server.dispose()


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--runs", type=int, default=100_000)
    options.add_argument("--database", default="", help="filled already, or empty; it stays")
    options.add_argument("--no-compare", action="store_true")
    given = options.parse_args()
    plugins = discover()
    with tempfile.TemporaryDirectory() as folder, _databases(folder, given.database) as urls:
        for name, url in urls.items():
            with open_store(url) as store:
                known = store.lists.count_runs()
            if not known:
                known = fill(url, given.runs, metrics=4, on_all=given.runs)
            print(f"== {name}: {known} runs of 20 measurements", flush=True)
            for what, step in Line(url, Path(folder), plugins).steps(*prepare(url)).items():
                fastest_s, median_s = times_s(step)
                late = "" if fastest_s <= _LIMIT_S else "  SLOWER than asked"
                print(f"{what:<40} {1e3 * fastest_s:7.1f} ms, median {1e3 * median_s:7.1f} ms{late}")
            if not given.no_compare:
                spent_s, memory_mb = timed(url, Path(folder) / "page.html")
                print(f"{'compare with its page':<40} {spent_s:7.1f} s, {memory_mb:.0f} MB", flush=True)


if __name__ == "__main__":
    main()
