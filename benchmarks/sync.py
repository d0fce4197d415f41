"""Runs sent to a central PostgreSQL by four stations at once."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, insert, select
from sqlalchemy.exc import OperationalError

from benchmarks.rows import Row
from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.app.run.run import run_sensor
from cbsr_qa.store.chain.check import select_run
from cbsr_qa.store.chain.links import add_links, add_rows
from cbsr_qa.store.chain.run_documents import FIGURES, KEYS, figures_digest
from cbsr_qa.store.engine import open_engine, parse_url, reading, writing
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.schema import upgrade
from cbsr_qa.store.tables.results import AnalysisRow, CalibrationRow
from cbsr_qa.store.tables.runs import Base, RunRow, SensorRow
from cbsr_qa.store.types import IdSource
from cbsr_qa.system.clock import RealClock

TITLE = "Synchronisation"

_STATIONS = 4
_RUNS = 15
_SERVER = "postgresql+psycopg://postgres@127.0.0.1:5432/postgres"
_CENTRE = "cbsr_qa_benchmark_sync"
#: What `cbsr-qa db sync` does between its start and its end.
_SEND = (
    "import gc, sys; from cbsr_qa.cli.main import COLLECTED;"
    "from cbsr_qa.store.engine import open_engine, parse_url; from cbsr_qa.store.sync.send import send_waiting;"
    "gc.set_threshold(*COLLECTED); station, centre = (open_engine(parse_url(url)) for url in sys.argv[1:]);"
    "print('ready', flush=True); input(); sent = send_waiting(station, centre, 'benchmark');"
    "print(sent.runs, sent.rows, sent.size)"
)


def rows() -> Iterator[Row]:
    """Four processes send the same number of copies of a nine-location run, each with all of its rows."""
    with tempfile.TemporaryDirectory() as folder, _centre() as centre:
        if centre is None:
            return
        stations = [_filled(Path(folder), number) for number in range(_STATIONS)]
        os.sync()  # or the disk still writes what was made for the measurement
        spent_s, sent = _send(stations, centre)
    runs, stored, size = (sum(one[k] for one in sent) for k in range(3))
    per_s = runs / spent_s
    each = f"{stored // runs} rows, {size / runs / 1e6:.1f} MB each"
    what = f"{runs} nine-location runs ({each}) from {_STATIONS} stations"
    yield Row(f"{what}: runs", "≥ 10 runs/s", f"{per_s:.1f} runs/s", "", per_s >= 10)
    yield Row(f"{what}: bytes", "≥ 20 MB/s", f"{size / spent_s / 1e6:.0f} MB/s", "", size / spent_s >= 20e6)


def _send(stations: list[str], centre: str) -> tuple[float, list[list[int]]]:
    """Have every station send at once; wall time and what each says of runs, rows and bytes."""
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    senders = [subprocess.Popen([sys.executable, "-c", _SEND, one, centre], **pipes) for one in stations]
    for sender in senders:
        assert sender.stdout is not None
        sender.stdout.readline()
    begun_s = time.monotonic()
    for sender in senders:
        assert sender.stdin is not None
        sender.stdin.write("\n")
        sender.stdin.flush()
    said = [sender.communicate()[0] for sender in senders]
    return time.monotonic() - begun_s, [list(map(int, one.split())) for one in said]


@contextmanager
def _centre() -> Iterator[str | None]:
    server = create_engine(_SERVER, isolation_level="AUTOCOMMIT", connect_args={"connect_timeout": 3})
    try:
        with server.connect() as connection:
            connection.exec_driver_sql(f"DROP DATABASE IF EXISTS {_CENTRE} WITH (FORCE)")
            connection.exec_driver_sql(f"CREATE DATABASE {_CENTRE}")
    except OperationalError:
        yield None
        return
    url = f"postgresql://postgres@127.0.0.1:5432/{_CENTRE}"
    engine = open_engine(parse_url(url))
    try:
        upgrade(engine)
        engine.dispose()
        yield url
    finally:
        with server.connect() as connection:
            connection.exec_driver_sql(f"DROP DATABASE IF EXISTS {_CENTRE} WITH (FORCE)")
        server.dispose()


def _filled(folder: Path, number: int) -> str:
    """Make the database of a station with copies of one simulated run of nine locations."""
    source = f"sqlite:///{folder / 'source.db'}"
    if number == 0:
        run_sensor(RunRequest("simulated", "nine-locations", "SOURCE", database=source))
    url = f"sqlite:///{folder / f'station-{number}.db'}"
    with open_store(url):
        pass
    engine, ids = open_engine(parse_url(url), durable=False), IdSource(RealClock().wall)
    with reading(open_engine(parse_url(source))) as connection:
        copied = Copied(connection)
    for copy in range(_RUNS):
        copied.store(engine, ids, f"P-{number}-{copy}")
    engine.dispose()
    return url


class Copied:
    """A stored run that can be stored again under other names, with a chain of its own."""

    def __init__(self, connection: Connection) -> None:
        (self._run,) = connection.scalars(select(RunRow.run)).all()
        self._rows = {}
        for name, table in ((name, Base.metadata.tables[name]) for name in KEYS):
            query = select(table).where(select_run(table, self._run)).order_by(*table.primary_key)
            self._rows[name] = [dict(row) for row in connection.execute(query).mappings()]
        self._sensor = dict(connection.execute(select(SensorRow.__table__)).mappings().one())

    def store(self, engine: Engine, ids: IdSource, serial: str) -> None:
        names: dict[str, str] = {}

        def renamed(row: Mapping[str, Any]) -> dict[str, Any]:
            for key in ("run", "analysis", "calibration"):
                if isinstance(row.get(key), str):
                    names.setdefault(row[key], ids.new())
            changed = {key: names.get(cell, cell) if isinstance(cell, str) else cell for key, cell in row.items()}
            return changed | ({"serial": serial} if "serial" in row and "batch" in row else {})

        run = names[self._run] = ids.new()
        with writing(engine) as connection:
            connection.execute(insert(SensorRow), self._sensor | {"serial": serial})
            for name, rows in self._rows.items():
                table = next(one.class_ for one in Base.registry.mappers if one.local_table.name == name)
                copies = [renamed(row) for row in rows]
                if name == CalibrationRow.__tablename__:
                    copies = [row | {"serial": serial} for row in copies]
                add_rows(connection, run, table, copies)
                if name == AnalysisRow.__tablename__:
                    analyses = [row["analysis"] for row in copies]
                if name == "measurements":
                    add_links(connection, run, [(FIGURES, one, figures_digest(connection, one)) for one in analyses])
