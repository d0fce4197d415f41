"""Certificates of a whole batch: ``python -m benchmarks.many_certificates [--sensors 1000]``.

Tests one simulated sensor, copies its run with new names and a new chain, and certifies the batch as ``cbsr-qa
certificate --batch`` does, signed and stored. Prints minutes for two workers, and the parts of a
certificate relative to reading its run, which do not depend on the machine.
"""

import argparse
import hashlib
import os
import re
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any, Final

import sqlalchemy as sa

from cbsr_qa.app.certificate.compose import choose_places
from cbsr_qa.app.certificate.issue import issue_batch
from cbsr_qa.app.certificate.request import CertificateRequest
from cbsr_qa.app.run.console import Unattended
from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.app.run.run import run_sensor
from cbsr_qa.calibration.file.hdf5 import calibration_of, stamp
from cbsr_qa.calibration.file.keys import new_key
from cbsr_qa.calibration.uncertainty.budget import evaluate_forces
from cbsr_qa.domain.results.certificate import Customer
from cbsr_qa.store.chain.check import digest_documents, select_run
from cbsr_qa.store.chain.links import link_digest
from cbsr_qa.store.chain.run_documents import FIGURES, KEYS, figures_digest
from cbsr_qa.store.engine import open_engine, parse_url, reading, writing
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.runs.begun import note_begun
from cbsr_qa.store.tables.records import LinkRow
from cbsr_qa.store.tables.results import CalibrationRow
from cbsr_qa.store.tables.runs import Base, SensorRow

_BATCH: Final = "B-1000"
#: Batch of a sensor for each worker, which takes as long to begin as any other.
_START: Final = "B-start"
_WORKERS: Final = 2
_REPEATS: Final = 5
_SENSORS: Final = 1000
_GOAL_MIN: Final = 5.0
_LABORATORY: Final = """[certificate]
laboratory = "Soft Sensor Works"
prefix = "SSW"
street = "Werkstraße 5"
post_code = "38116"
city = "Braunschweig"
country = "DE"
place = "Hall 3"
performed_at = "laboratory"
signatory = "Ada Otani"
function = "head of the laboratory"
max_error_N = 0.6
decision = "guarded"
"""

Rows = dict[str, list[dict[str, Any]]]


class StoredRun:
    """A run of a database, which is stored again under other names."""

    def __init__(self, url: str, run: str) -> None:
        self.run, self._engine = run, open_engine(parse_url(url), durable=False)
        with reading(self._engine) as connection:
            self._rows: Rows = {
                table.name: [
                    dict(row) for row in connection.execute(sa.select(table).where(select_run(table, run))).mappings()
                ]
                for table in Base.metadata.sorted_tables
                if table.name in KEYS
            }
            self._serial = self._rows["runs"][0]["serial"]
            self._sensor = dict(
                connection.execute(sa.select(SensorRow.__table__).where(SensorRow.serial == self._serial))
                .mappings()
                .one()
            )
            links = sa.select(LinkRow.__table__).where(LinkRow.run == run).order_by(LinkRow.number)
            self._links = [dict(row) for row in connection.execute(links).mappings()]
        (stored,) = self._rows[CalibrationRow.__tablename__]
        self._issued = calibration_of(stored["file"], issued=stored["content_sha256"])

    def store_again(self, serial: str, batch: str, new_id: Callable[[], str]) -> None:
        """Store the run as that of another sensor, with its calibration and a chain of its own."""
        analysis, calibration = self._rows["analyses"][0]["analysis"], self._issued.calibration
        names = {self.run: new_id(), analysis: new_id(), calibration: new_id(), self._serial: serial, _START: batch}
        sensor = replace(self._issued.sensor, serial=serial, batch=batch)
        issued = stamp(
            replace(self._issued, run=names[self.run], calibration=names[calibration], sensor=sensor, digest="")
        )
        rows: Rows = {
            name: [
                {key: names.get(cell, cell) if isinstance(cell, str) else cell for key, cell in row.items()}
                for row in own
            ]
            for name, own in self._rows.items()
        }
        digests = {"content_sha256": issued.digest, "record_sha256": issued.record_digest, "file": issued.file}
        rows[CalibrationRow.__tablename__][0] |= digests | {"file_sha256": hashlib.sha256(issued.file).hexdigest()}
        with writing(self._engine) as connection:
            connection.execute(sa.insert(SensorRow), self._sensor | {"serial": serial})
            for name, own in rows.items():
                if own:
                    connection.execute(sa.insert(Base.metadata.tables[name]), own)
            self._link(connection, names)
            note_begun(connection, names[self.run])

    def _link(self, connection: sa.Connection, names: dict[str, str]) -> None:
        run, before = names[self.run], ""
        contents = {(kind, key): content for kind, key, content in digest_documents(connection, run)}
        of_old = re.compile("|".join(map(re.escape, names)))
        links = []
        for link in self._links:
            document = of_old.sub(lambda found: names[found[0]], link["document"])
            of_figures = link["kind"] == FIGURES
            content = figures_digest(connection, document) if of_figures else contents[link["kind"], document]
            before = link_digest(before, link["kind"], document, content)
            links.append(link | {"run": run, "document": document, "content_sha256": content, "sha256": before})
        connection.execute(sa.insert(LinkRow), links)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--sensors", type=int, default=_SENSORS)
    count = options.parse_args().sensors
    with tempfile.TemporaryDirectory() as folder:
        os.environ["CBSR_QA_VAR"] = folder
        url, at = f"sqlite:///{folder}/runs.db", Path(folder)
        (at / "laboratory.toml").write_text(_LABORATORY, encoding="utf-8")
        new_key(at / "station.key")
        asked = RunRequest(
            station="simulated", recipe="nine-locations", serial="S-0", batch=_START, operator="Ada", database=url
        )
        run_sensor(asked, Unattended())
        with open_store(url) as store:
            first = StoredRun(url, store.runs.resolve("S-0"))
            for number in range(1, count + _WORKERS):
                first.store_again(f"S-{number}", _START if number < _WORKERS else _BATCH, store.new_id)
        request = CertificateRequest(
            folder=at / "certificates",
            customer=Customer("Robots plc", "Ring 1, 10115 Berlin"),
            settings_file=at / "laboratory.toml",
            key=at / "station.key",
        )
        began_s, began_cpu_s = _certify(_START, request, url, _WORKERS)
        spent_s, cpu_s = _certify(_BATCH, request, url, count)
        each_s, load = (cpu_s - began_cpu_s) / (count - _WORKERS), os.getloadavg()[0]
        print(f"{count} certificates: {spent_s:.0f} s, {cpu_s:.0f} s of processors, load {load:.1f}")
        minutes = (began_s + (spent_s - began_s) / (count - _WORKERS) * _SENSORS) / 60
        alone = (began_cpu_s + each_s * _SENSORS) / 60 / _WORKERS
        late = "" if minutes <= _GOAL_MIN else f"  SLOWER than the {_GOAL_MIN:g} asked"
        print(
            f"{_SENSORS} certificates: {minutes:.1f} min{late}; {alone:.1f} min by the time of {_WORKERS} processors"
        )
        with open_store(url) as store:
            _print_parts(store, url, request)


def _certify(batch: str, request: CertificateRequest, url: str, count: int) -> tuple[float, float]:
    """Certify a batch, and return the time that it took, and that of its workers' processors [s]."""
    began, used = time.perf_counter(), os.times()
    made = issue_batch(batch, request, lambda *_: None, database=url).result
    spent_s, now = time.perf_counter() - began, os.times()
    assert len(made.issued) == count, made.refused[:1]
    return spent_s, now.children_user + now.children_system - used.children_user - used.children_system


def _print_parts(store: Repository, url: str, request: CertificateRequest) -> None:
    """Print what parts of a certificate take, relative to reading the run."""
    run = store.runs.resolve("S-1")
    (analysis,) = store.analyses.load(run)
    assert analysis.calibration is not None
    file, digest = store.calibrations.load_file(analysis.calibration)
    issued = calibration_of(file, issued=digest)
    parts = {
        "read and check the run": lambda: store.runs.load(run),
        "read its calibration": lambda: calibration_of(file, issued=digest),
        "budget": lambda: evaluate_forces(issued, None, choose_places(issued)),
    }
    times_s = {name: _median_s(part) for name, part in parts.items()}
    (reading_s, *_) = times_s.values()
    for name, time_s in times_s.items():
        print(f"{name:<26} {1e3 * time_s:6.0f} ms, {time_s / reading_s:5.2f} of reading the run")


def _median_s(part: Callable[[], object]) -> float:
    times = []
    for _ in range(_REPEATS):
        began = time.process_time()
        part()
        times.append(time.process_time() - began)
    return median(times)


if __name__ == "__main__":
    main()
