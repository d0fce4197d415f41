"""Databases of stations that are sent to a central one, and whether everything arrived."""

import os
import shutil
import signal
from contextlib import contextmanager
from datetime import UTC, datetime

import pytest
import sqlalchemy as sa
from altered_runs import certificate
from stored_runs import calibration, frames, journalled, short_run

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Limit, Outcome
from cbsr_qa.domain.results.charts import ChartKind, ChartReference
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.gate import Release
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult, RingReadings, StationCheck
from cbsr_qa.store.chain.check import check_run, digest_documents, select_run
from cbsr_qa.store.chain.links import link_digest
from cbsr_qa.store.chain.run_documents import FIGURES, KEYS, documents, figures_digest
from cbsr_qa.store.engine import open_engine, parse_url, reading, writing
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.schema import upgrade
from cbsr_qa.store.sync import copying
from cbsr_qa.store.sync.queue import waiting
from cbsr_qa.store.sync.send import send_waiting
from cbsr_qa.store.tables.records import LinkRow
from cbsr_qa.store.tables.runs import Base
from cbsr_qa.system.clock import RealClock

#: Tables that say what is to be sent, and what was begun in a database itself.
OWN = {"outbox", "sync_refusals", "sync_settlements", "sync_accepts", "runs_begun"}
NOW = datetime(2026, 11, 27, 8, 0, tzinfo=UTC)


def opened(url):
    """Return the engine of an up-to-date database."""
    engine = open_engine(parse_url(url), durable=False)
    upgrade(engine)
    return engine


class Place:
    """A database with its repository."""

    def __init__(self, url):
        self.url, self.engine = url, opened(url)
        self.store = Repository(self.engine, RealClock().wall)

    def said(self, statement, *values):
        with reading(self.engine) as connection:
            return connection.exec_driver_sql(statement, values or None).all()

    def change(self, statement):
        with writing(self.engine) as connection:
            assert connection.exec_driver_sql(statement).rowcount != 0, statement


def sent(station, centre, **how):
    """Send what waits at one place to another."""
    return send_waiting(station.engine, centre.engine, "a test", **how)


_POSTGRES = pytest.param("postgresql", marks=pytest.mark.postgres)
_POSTGRES_TOO = pytest.param("postgresql", marks=(pytest.mark.postgres, pytest.mark.rest))
#: With a centre of each kind: in ``make test``, or on PostgreSQL, which is the same there, in ``make test-rest``.
at_once_on_both = pytest.mark.parametrize("centre", ["sqlite", _POSTGRES], indirect=True)
on_both = pytest.mark.parametrize("centre", ["sqlite", _POSTGRES_TOO], indirect=True)


def remove_run(place, run, *, begun=False):
    """Delete every row of a run that was not announced, as somebody with write access can.

    Parameters
    ----------
    begun : also the row that says that it was begun here.
    """
    with writing(place.engine) as connection:
        for table in reversed(Base.metadata.sorted_tables):
            if table.name in KEYS or table.name in ("run_links", "archives"):
                connection.execute(table.delete().where(select_run(table, run)))
        connection.exec_driver_sql(f"DELETE FROM outbox WHERE item = '{run}'")
        if begun:
            connection.exec_driver_sql(f"DELETE FROM runs_begun WHERE run = '{run}'")


def link_again(place, run):
    """Compute the links of a run again from its rows, as somebody who knows how they are computed can."""
    with writing(place.engine) as connection:
        contents = {(kind, key): content for kind, key, content in digest_documents(connection, run)}
        links = connection.execute(sa.select(LinkRow.__table__).where(LinkRow.run == run).order_by(LinkRow.number))
        before = ""
        for link in links.all():
            of_figures = link.kind == FIGURES
            content = figures_digest(connection, link.document) if of_figures else contents[link.kind, link.document]
            before = link_digest(before, link.kind, link.document, content)
            same = sa.update(LinkRow).where(LinkRow.run == run, LinkRow.number == link.number)
            connection.execute(same.values(content_sha256=content, sha256=before))


def add_rows(place, run, rows, figures="", mac=None):
    """Add rows to a run with links that are right, as a login can that does not have the key.

    Parameters
    ----------
    rows : table and row.
    figures : analysis whose figures get a link too.
    mac : what stands for the signature of the links.
    """
    with writing(place.engine) as connection:
        newest = sa.select(LinkRow.number, LinkRow.sha256).where(LinkRow.run == run)
        number, before = connection.execute(newest.order_by(LinkRow.number.desc()).limit(1)).one()
        for table, own in rows:
            connection.execute(sa.insert(table), own)
        added = [(table.name, *one) for table, own in rows for one in documents(table, [own])]
        added += [(FIGURES, figures, figures_digest(connection, figures))] if figures else []
        for kind, document, content in added:
            number, before = number + 1, link_digest(before, kind, document, content)
            link = {"run": run, "number": number, "kind": kind, "document": document, "mac": mac}
            connection.execute(sa.insert(LinkRow), link | {"content_sha256": content, "sha256": before})


def withdraw_verdict(place, run, mac=None):
    """Have a run look as if it went on, as :func:`add_rows`."""
    (last,) = _latest_rows(place, "run_states", run, "number")
    row = last | {"number": last["number"] + 1, "end": "running"}
    add_rows(place, run, [(Base.metadata.tables["run_states"], row)], mac=mac)


def replace_analysis(place, run, mac=None):
    """Have a run pass by a new analysis, as :func:`add_rows`."""
    (last,) = _latest_rows(place, "analyses", run, "analysis")
    name = place.store.new_id()
    made = last | {"analysis": name, "outcome": "pass", "reason": "all limits are met"}
    measured = {"analysis": name, "value": 0.1, "outcome": "pass"}
    tables = Base.metadata.tables
    table = tables["measurements"]
    with reading(place.engine) as connection:
        old = (
            connection.execute(sa.select(table).where(table.c.analysis == last["analysis"]).limit(1)).mappings().one()
        )
    add_rows(place, run, [(tables["analyses"], made), (table, dict(old) | measured)], figures=name, mac=mac)


def _latest_rows(place, name, run, order):
    table = Base.metadata.tables[name]
    found = sa.select(table).where(table.c.run == run).order_by(table.c[order].desc()).limit(1)
    with reading(place.engine) as connection:
        return [dict(row) for row in connection.execute(found).mappings()]


def judged(repository, run, *, issued=None, outcome=Outcome.PASS):
    """Store a result of a run, with a calibration if one is given."""
    measured = Measurement("drift", 0.01, "%/min").judge(Limit("drift", "%/min", -0.5, 0.5, 0.1))
    verdict = Verdict(outcome, "as told")
    repository.analyses.save(RunResult(repository.runs.load(run), None, (measured,), verdict, issued, "none"))


def run_of(repository, serial="S-1", *, events=None):
    """Journal a short run; returns its name."""
    run = repository.new_id()
    journalled(repository, short_run(run, serial)[:events])
    return run


def everything(repository, serial="S-1"):
    """Store one of everything that is sent: a run with results, an override and a certificate that was replaced."""
    run = run_of(repository, serial)
    judged(repository, run, issued=calibration(repository.new_id(), run, serial))
    judged(repository, run, issued=calibration(repository.new_id(), run, serial))
    repository.changes.override_verdict(run, Outcome.FAIL, operator="Zoë", why="so")
    latest = repository.calibrations.list_issued(serial)[0].calibration
    number = f"LAB-{run}"
    repository.certificates.save(certificate(run, latest, number=number))
    repository.certificates.save(certificate(run, latest, number=f"{number}-R1", replaces=number, why="so"))
    lines = (CheckResult("gain error", CheckOutcome.OK, 0.1, "%", "−1 to 1 %", "", subject="ring"),)
    check = StationCheck(repository.new_id(), "bench-α", "Zoë", NOW, "disc", 64 * "a", (), (), lines, run)
    repository.stations.save_check(check, RingReadings(frames(0.0, 3, own_times=True), (1e4,) * 16))
    repository.releases.save(Release(repository.new_id(), "recipe", "short", 64 * "b", "released", "Zoë", "so", NOW))
    where = {"station": "bench-α", "recipe": "short", "golden": None, "unit": "%/min"}
    period = {"runs": 2, "first_run": run, "last_run": run, "mean": 0.05, "deviation": 0.01}
    of = {"name": "drift", "phase": "", "qualifier": "", "location": "", "chart": ChartKind("i-mr")}
    made = {"reference": repository.new_id(), "operator": "Zoë", "made_at": NOW, "why": "", "rules": (1, 5)}
    repository.charts.save([ChartReference(**where, **of, **period, **made)])
    return run


def content(engine, runs=None):
    """Every row of every table that is sent, sorted."""
    with reading(engine) as connection:
        return {
            table.name: sorted(map(repr, connection.execute(sa.select(table))))
            for table in Base.metadata.sorted_tables
            if table.name not in OWN
        }


def assert_all_there(centre, *stations):
    """The centre holds the rows of the stations, each once; every chain holds; nothing waits."""
    theirs = [content(station) for station in stations]
    for name, rows in content(centre).items():
        expected = sorted({row for one in theirs for row in one[name]})
        assert rows == expected, name
    with reading(centre) as connection:
        for run in connection.scalars(sa.text("SELECT run FROM runs")).all():
            assert check_run(connection, run).chained
    assert [waiting(station) for station in stations] == [()] * len(stations)


@contextmanager
def struck(at, strike):
    """Call ``strike`` at a statement or a row that is sent, counted from 0; yields the count so far."""
    count = [0]

    def tick(*_):
        count[0] += 1
        if count[0] - 1 == at:
            strike()

    encoded, at_once = copying.encode_rows, copying.AT_ONCE

    def encoded_ticking(table, rows):
        tick()
        return encoded(table, rows)

    sa.event.listen(sa.Engine, "after_cursor_execute", tick)
    sa.event.listen(sa.Engine, "commit", tick)
    copying.encode_rows, copying.AT_ONCE = encoded_ticking, 1
    try:
        yield count
    finally:
        copying.encode_rows, copying.AT_ONCE = encoded, at_once
        sa.event.remove(sa.Engine, "after_cursor_execute", tick)
        sa.event.remove(sa.Engine, "commit", tick)


def in_a_fork(work):
    """Do something in a process of its own; returns its exit status."""
    child = os.fork()
    if child == 0:
        try:
            work()
            os._exit(0)
        finally:
            os._exit(1)
    return os.waitpid(child, 0)[1]


def points(station_url, centre_url):
    """Send, and return the number of points at which that could have been struck."""
    with struck(-1, lambda: None) as count:
        send(station_url, centre_url)
    return count[0]


def killed(station_url, centre_url, at):
    """Send in a process that is killed at a point; returns whether it was."""

    def work():
        with struck(at, lambda: os.kill(os.getpid(), signal.SIGKILL)):
            send(station_url, centre_url)

    return os.WIFSIGNALED(in_a_fork(work))


def send(station_url, centre_url):
    """Send what waits over new connections."""
    station, centre = opened(station_url), opened(centre_url)
    try:
        return send_waiting(station, centre, "a test")
    finally:
        station.dispose()
        centre.dispose()


def cutting(server, url):
    """Return what sends while the server ends all connections to its database at a point, as :func:`killed`."""
    name = url.rpartition("/")[2]
    cut = (
        f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = '{name}' AND pid <> pg_backend_pid()"
    )

    def sent(station_url, centre_url, at):
        try:
            with struck(at, lambda: server.execute(cut)):
                send(station_url, centre_url)
        except StoreError as error:
            if "closed the connection" not in error.reason:
                raise
            return True
        return False

    return sent


def struck_again(template, path, url, points, strike):
    """Send from a copy of a database, struck at some points; then send the rest. Returns how often it was struck."""
    shutil.copy(template, path)
    station = f"sqlite:///{path}"
    opened(url).dispose()
    times = sum(strike(station, url, point) for point in points)
    send(station, url)
    ours, theirs = opened(station), opened(url)
    assert_all_there(theirs, ours)
    ours.dispose()
    theirs.dispose()
    return times


def overridden(station):
    """Override the verdict of the only run, which announces it; returns the run."""
    ((run,),) = station.said("SELECT run FROM runs")
    station.store.changes.override_verdict(run, Outcome.PASS, operator="Zoë", why="so")
    return run
