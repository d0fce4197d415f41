"""Time and memory of ``cbsr-qa compare`` with its page on a fleet: ``python -m benchmarks.fleet_comparison``.

Fills a database with simulated runs of which only what a comparison reads is there (no frames), unless it holds runs
already: every sensor once, some (every third) on all three stations; three batches, each mostly on its own. Then
compares batches in a separate process, and prints its time and peak memory.
"""

import argparse
import hashlib
import os
import sys
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import Connection, insert

from benchmarks.timing import whole_command
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.store.chain.links import link_digest
from cbsr_qa.store.chain.run_documents import FIGURES, documents, figures_digest
from cbsr_qa.store.engine import open_engine, parse_url, writing
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.runs.codec import encode_setting
from cbsr_qa.store.tables.records import LinkRow
from cbsr_qa.store.tables.results import AnalysisRow, MeasurementRow
from cbsr_qa.store.tables.runs import RunRow, RunStateRow, SensorRow
from cbsr_qa.store.types import IdSource

STATIONS = ("A", "B", "C")
BATCHES = ("41", "42", "43")
PLACES = 9
_START = datetime(2026, 1, 5, 8, 0, tzinfo=UTC)
_SOFTWARE = [["cbsr-qa", "0.1.0"], ["numpy", "2.0"], ["scipy", "1.13"]]
Rows = list[dict[str, Any]]


def fill(url: str, sensors: int, metrics: int, on_all: int, seed: int = 41) -> int:
    """Store a fleet.

    Parameters
    ----------
    metrics : of each run; the first two have a value a place, as ``centre_of_mass_error`` has.
    on_all : every how many sensors of a batch one runs on all stations.

    Returns
    -------
    Number of runs.
    """
    from cbsr_qa.config.loader import load_material, load_sensor_type

    setting = encode_setting(load_sensor_type("disc-100mm").value, Indenter(13.0), load_material("cbsr-8wt").value)
    with open_store(url, durable=False) as store:
        store.count_rows()
    engine, random, runs = open_engine(parse_url(url), durable=False), np.random.default_rng(seed), 0
    for first in range(0, sensors, 250):
        tables: dict[Any, Rows] = {t: [] for t in (SensorRow, RunRow, RunStateRow, AnalysisRow, MeasurementRow)}
        for number in range(first, min(first + 250, sensors)):
            runs += _sensor(tables, number, metrics, on_all, random, setting)
        with writing(engine) as connection:
            for table, rows in tables.items():
                connection.execute(insert(table), rows)
            connection.execute(insert(LinkRow), list(_links(connection, tables)))
    engine.dispose()
    return runs


def _links(connection: Connection, tables: dict[Any, Rows]) -> Iterator[dict[str, Any]]:
    """The chains of the runs, as the journal and the analysis would have made them, for all runs at once."""
    of_run: dict[str, list[tuple[str, str, str]]] = {row["run"]: [] for row in tables[RunRow]}
    owner = {row["analysis"]: row["run"] for row in tables[AnalysisRow]}
    for table, rows in tables.items():
        if table is not SensorRow:
            for run, some in groupby(rows, lambda row: row.get("run") or owner[row["analysis"]]):
                of_run[run] += [(table.__tablename__, *one) for one in documents(table.__table__, list(some))]
    for analysis, run in owner.items():
        of_run[run].append((FIGURES, analysis, figures_digest(connection, analysis)))
    for run, entries in of_run.items():
        before = ""
        for number, (kind, document, content) in enumerate(entries):
            before = link_digest(before, kind, document, content)
            values = {"kind": kind, "document": document, "content_sha256": content, "sha256": before, "mac": None}
            yield {"run": run, "number": number, **values}


def _sensor(
    tables: dict[Any, Rows],
    number: int,
    metrics: int,
    on_all: int,
    random: np.random.Generator,
    setting: dict[str, Any],
) -> int:
    serial, batch = f"S-{number:05d}", number % 3
    stations = (
        range(3) if (number // 3) % on_all == 0 else [batch if random.random() < 0.6 else int(random.integers(3))]
    )
    began = _START + timedelta(minutes=40 * number)
    tables[SensorRow].append({"serial": serial, "batch": BATCHES[batch], "sensor_type": "disc-100mm"})
    own = random.standard_normal(metrics)
    for again, station in enumerate(stations):
        at = began + timedelta(minutes=again)
        ids = IdSource(lambda at=at: at)  # type: ignore[misc]
        run, analysis = ids.new(), ids.new()
        tables[RunRow].append(
            {
                "run": run,
                "serial": serial,
                "batch": BATCHES[batch],
                "sensor_type": "disc-100mm",
                "station": STATIONS[station],
                "recipe": "nine-locations",
                "operator": "simulated",
                "started_at": at,
                "configuration": "{}",
                "configuration_digest": hashlib.sha256(b"{}").hexdigest(),
                "software": _SOFTWARE,
                "simulated": ["the whole fleet"],
                "setting": setting,
                "chain": "sha256",
            }
        )
        state = {"detail": "", "time_s": 0.0, "spent": [], "operator": None, "software": None, "noted_at": None}
        tables[RunStateRow] += [
            {"run": run, "number": n, "end": end, **state} for n, end in enumerate(("running", "finished"))
        ]
        rows = list(_measurements(random, analysis, metrics, own + 1.5 * (batch == 1) + 1.5 * (station == 0)))
        outcome = "fail" if any(row["outcome"] == "fail" for row in rows) else "pass"
        tables[AnalysisRow].append(_analysis(analysis, run, at, outcome))
        tables[MeasurementRow] += rows
    return len(stations)


def _analysis(analysis: str, run: str, at: datetime, outcome: str) -> dict[str, Any]:
    ends = {"outcome": outcome, "reason": "simulated", "calibration_why": "", "noise_weighting": "equal"}
    more: dict[str, Any] = {"weight_ratio": None, "compute_s": []}
    return {"analysis": analysis, "run": run, "analysed_at": at, "software": _SOFTWARE, **ends, **more}


def _measurements(
    random: np.random.Generator, analysis: str, metrics: int, level: "np.ndarray[Any, Any]"
) -> Iterator[dict[str, Any]]:
    number = 0
    for metric in range(metrics):
        for place in range(PLACES if metric < 2 else 1):
            value = 10.0 + float(level[metric]) + 0.3 * float(random.standard_normal())
            limited = metric < 10
            yield {
                "analysis": analysis,
                "number": number,
                "name": f"metric_{metric:02d}",
                "value": value,
                "unit": "mm",
                "uncertainty": None,
                "phase": "nine locations" if metric < 2 else "",
                "location": f"L{place}" if metric < 2 else "",
                "trial": None,
                "qualifier": "",
                "how": "",
                "bound": "exact",
                "load_index": None,
                "strain": None,
                "outcome": ("fail" if value > 16.0 else "pass") if limited else "not judged",
                "limited": limited,
                "lower_limit": None,
                "upper_limit": 16.0 if limited else None,
                "marginal": 0.0 if limited else None,
                "limit_phase": "" if limited else None,
                "limit_qualifier": "" if limited else None,
            }
            number += 1


def timed(url: str, page: Path) -> tuple[float, float]:
    """Compare batches in a separate process; return its time [s] and peak memory [MB]."""
    command = [sys.executable, "-c", "from cbsr_qa.cli.main import entry; entry()", "compare", "--by", "batch"]
    return whole_command([*command, "--database", url, "--output", str(page)])


def exported(url: str, table: Path) -> tuple[float, float]:
    """Export all measurements in a separate process; return its time [s] and peak memory [MB]."""
    command = [sys.executable, "-c", "from cbsr_qa.cli.main import entry; entry()", "export"]
    return whole_command([*command, "--database", url, "--table", "measurements", "--to", str(table), "--force"])


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--sensors", type=int, default=10_000)
    options.add_argument("--metrics", type=int, default=30)
    options.add_argument("--on-all", type=int, default=3, help="every how many sensors one runs on all stations")
    options.add_argument("--database", default="")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        url = given.database or f"sqlite:///{folder}{os.sep}fleet.db"
        with open_store(url) as store:
            filled = bool(store.count_rows().get("runs"))
        if not filled:
            print(
                f"{fill(url, given.sensors, given.metrics, given.on_all)} runs of {given.sensors} sensors", flush=True
            )
        spent_s, memory_mb = timed(url, Path(folder) / "page.html")
    print(f"compare with its page: {spent_s:.1f} s, {memory_mb:.0f} MB")


if __name__ == "__main__":
    main()
