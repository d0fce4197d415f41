"""Batches compared: the mixed model beside statsmodels', and whole commands on a fleet of 10 000 sensors."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import create_engine
from sqlalchemy.exc import OperationalError
from statsmodels.regression.mixed_linear_model import MixedLM

from benchmarks.fleet_comparison import exported, fill, timed
from benchmarks.rows import Row, ratio_row
from benchmarks.timing import compare
from cbsr_qa.stats.crossings import Crossing, crossing
from cbsr_qa.stats.mixed_model.model import fit

TITLE = "Batches compared"

Array = NDArray[np.float64]

_SENSORS = 3000
_SERVER = "postgresql+psycopg://postgres@127.0.0.1:5432/postgres"


def rows() -> Iterator[Row]:
    """One metric of 3000 sensors, then ``cbsr-qa compare`` with its page of 10 000 sensors and 30 metrics."""
    design, sensors, values = _fleet()
    matrix = design.columns().toarray()
    found, theirs = fit(design, values), MixedLM(values, matrix, groups=sensors).fit(reml=True)
    apart = float(np.abs(found.effects[design.independent_columns()] - theirs.fe_params).max())
    yield ratio_row(
        compare(
            f"one metric of {_SENSORS} sensors in {len(values)} runs, batches and stations fixed, sensors random;"
            f" effects alike to {apart:.0e} deviations",
            ("sensors eliminated, with Kenward and Roger's intervals", lambda: fit(design, values)),
            ("statsmodels MixedLM", lambda: MixedLM(values, matrix, groups=sensors).fit(reml=True)),
            repeats=5,
        ),
        20.0,
    )
    with tempfile.TemporaryDirectory() as folder:
        yield from _whole("SQLite", f"sqlite:///{folder}/fleet.db", Path(folder))
        yield from _on_server(Path(folder))


def notes() -> str:
    return (
        "\nTimes include Python's start, reading, fitting every metric, drawing and writing the page; the"
        " fastest of three counts. Every third sensor ran on all three stations, the others on one: 16 668"
        " runs, 770 000 values.\n"
    )


def _fleet() -> tuple[Crossing, Array, Array]:
    """Every third sensor on all three stations, the others on one."""
    random = np.random.default_rng(3000)
    runs = [
        (sensor % 3, station, sensor)
        for sensor in range(_SENSORS)
        for station in (range(3) if sensor // 3 % 3 == 0 else [int(random.integers(3))])
    ]
    batch, station, sensor = np.array(runs).T
    own = random.normal(size=_SENSORS)
    values = own[sensor] + 1.5 * (batch == 1) + 1.5 * (station == 0) + 0.3 * random.normal(size=len(runs))
    names = [[f"{kind}{one}" for one in column] for kind, column in zip("bst", (batch, station, sensor), strict=True)]
    return crossing(*names), sensor, values


def _whole(database: str, url: str, folder: Path) -> Iterator[Row]:
    runs = fill(url, 10_000, 30, 3)
    times = [timed(url, folder / "page.html") for _ in range(3)]
    spent_s, memory_mb = min(one for one, _ in times), max(one for _, one in times)
    yield Row(
        f"`cbsr-qa compare` with its page, 10 000 sensors, {runs} runs, 30 metrics, {database}",
        "≤ 5 s in ≤ 1 GB",
        f"{spent_s:.1f} s, {memory_mb:.0f} MB",
        "",
        spent_s <= 5 and memory_mb <= 1000,
    )
    for suffix in ("csv", "parquet"):
        spent_s, memory_mb = exported(url, folder / f"measurements.{suffix}")
        yield Row(
            f"`cbsr-qa export` of 770 000 measurements to .{suffix}, {database}",
            "≤ 60 s in ≤ 500 MB",
            f"{spent_s:.1f} s, {memory_mb:.0f} MB",
            "",
            spent_s <= 60 and memory_mb <= 500,
        )


def _on_server(folder: Path) -> Iterator[Row]:
    """The same on PostgreSQL, where a server answers."""
    server = create_engine(_SERVER, isolation_level="AUTOCOMMIT", connect_args={"connect_timeout": 3})
    name = "cbsr_qa_benchmark"
    try:
        with server.connect() as connection:
            connection.exec_driver_sql(f"DROP DATABASE IF EXISTS {name}")
            connection.exec_driver_sql(f"CREATE DATABASE {name}")
    except OperationalError:
        return
    try:
        yield from _whole("PostgreSQL", f"postgresql://postgres@127.0.0.1:5432/{name}", folder)
    finally:
        with server.connect() as connection:
            connection.exec_driver_sql(f"DROP DATABASE IF EXISTS {name} WITH (FORCE)")
        server.dispose()
