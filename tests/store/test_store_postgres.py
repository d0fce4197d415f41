"""The same store on PostgreSQL: what was told comes back, unchanged in any bit."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from datetime import UTC, date, datetime

import numpy as np
import pytest
import sqlalchemy as sa
from calibration_samples import sample_force
from stored_lots import measured, store_run
from stored_runs import calibration, journalled, short_run

from cbsr_qa.app.database import database_status
from cbsr_qa.calibration.file.hdf5 import stamp
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.charts import ChartReference
from cbsr_qa.domain.results.fleet import MetricKey, RunSelection
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.store.chain.links import add_links
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.opening import open_store

pytestmark = pytest.mark.postgres


@pytest.fixture(scope="module")
def url(postgres_server):
    with postgres_server.new_database() as url:
        yield url


@pytest.fixture
def repository(url):
    with open_store(url) as opened:
        yield opened


def test_a_database_that_is_opened_again_meanwhile_leaves_no_connection_open(postgres_database):
    """The fixture drops the database, which fails while anyone is connected."""
    with (
        open_store(postgres_database) as outer,
        outer.claims.hold_run("run-1"),
        open_store(postgres_database) as inner,
    ):
        assert inner.claims.name_writer("run-1") == outer.claims.name_writer("run-1") != ""


def test_results_and_calibrations_come_back(repository):
    run = repository.new_id()
    journalled(repository, short_run(run, "S-9"))
    issued = calibration(repository.new_id(), run, "S-9")
    model = sample_force(int(issued.reconstruction.problem.used.sum()))
    issued = stamp(replace(issued, force=model, digest="", record_digest=""))
    measured = (Measurement("noise_floor", np.float64(0.1) + np.float64(0.2), "1", trial=np.int64(1)),)
    verdict = Verdict(Outcome.MARGINAL, "close\0to the limit")
    repository.analyses.save(
        RunResult(repository.runs.load(run), None, measured, verdict, issued, "", warnings=("one",))
    )
    (analysis,) = repository.analyses.load(run)
    assert analysis.measurements == measured
    assert analysis.verdict.reason == "close\ufffdto the limit"  # PostgreSQL holds no NUL
    file, digest = repository.calibrations.load_file(issued.calibration)
    assert (file, digest) == (issued.file, issued.digest)
    later = calibration(repository.new_id(), run, "S-9")
    repository.analyses.save(RunResult(repository.runs.load(run), None, measured, verdict, later, ""))
    held = {c.calibration: c.superseded_by for c in repository.calibrations.list_issued("S-9")}
    assert held == {issued.calibration: later.calibration, later.calibration: None}


def test_a_hostile_name_finds_nothing(repository):
    with pytest.raises(StoreError):
        repository.runs.resolve("'; DROP TABLE runs; --")
    with pytest.raises(StoreError):
        repository.runs.resolve("a\0b")
    assert repository.count_rows()["runs"] >= 0


def test_the_status_names_a_run_that_was_cut_off(repository, url):
    run = repository.new_id()
    journalled(repository, short_run(run, "S-cut")[:8])
    status = database_status(url).result
    assert [(one.run, one.serial) for one in status.incomplete] == [(run, "S-cut")]
    assert status.state == "current"


def test_figures_of_many_runs_and_references_of_charts_are_those_of_sqlite(repository, tmp_path):
    told = []
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}") as other:
        for store in (repository, other):
            runs = [store_run(store, f"F-{k}", measured(np.random.default_rng(k), np.ones(3))) for k in range(3)]
            selection = RunSelection(
                serials=("F-0", "F-1", "F-2"), recipe="short", since=date(2026, 11, 21), checks=False, latest=2
            )
            assert [line.run for line in store.fleet.read_lines(selection)] == runs[1:]
            told.append(store.fleet.load_table(selection))
            of = {
                "station": "bench",
                "recipe": "short",
                "golden": None,
                "unit": "%/min",
                **asdict(MetricKey("drift")),
            }
            limits = {"rules": (1, 5), "mean": 0.05, "deviation": 0.01}
            period = {"runs": 2, "first_run": runs[0], "last_run": runs[2]}
            made = {"reference": store.new_id(), "operator": "Zoë", "made_at": datetime.now(UTC), "why": ""}
            one = ChartReference(**of, **limits, **period, **made)
            store.charts.save([one])
            assert store.charts.read_current("bench") == (one,)
    assert told[0].kinds == told[1].kinds
    for column in ("run", "kind", "value", "state"):
        np.testing.assert_array_equal(getattr(told[0], column), getattr(told[1], column))


def test_programs_that_add_to_one_run_follow_one_another(repository):
    """The second waits for the first to commit, and then follows its link: it sees no older state."""
    run, engine = repository.new_id(), repository._engine
    journalled(repository, short_run(run))

    def add(document):
        with writing(engine) as connection:
            add_links(connection, run, [("verdict_overrides", document, "0" * 64)])

    waiting = sa.text("SELECT count(*) FROM pg_locks WHERE locktype = 'advisory' AND NOT granted")
    with ThreadPoolExecutor(1) as second:
        with writing(engine) as connection:
            add_links(connection, run, [("verdict_overrides", "first", "0" * 64)])
            later = second.submit(add, "second")
            while not connection.scalar(waiting):
                assert not later.done(), later.result()
        later.result(timeout=10)
    with reading(engine) as connection:
        links = sa.text("SELECT document FROM run_links WHERE run = :run ORDER BY number DESC LIMIT 2")
        assert connection.scalars(links, {"run": run}).all() == ["second", "first"]


def test_what_is_committed_meanwhile_does_not_show_in_a_read_transaction(repository):
    run, engine = repository.new_id(), repository._engine
    journalled(repository, short_run(run))
    with reading(engine) as connection:
        count = sa.text("SELECT count(*) FROM run_links")
        before = connection.scalar(count)
        with writing(engine) as other:
            add_links(other, run, [("verdict_overrides", "later", "0" * 64)])
        assert connection.scalar(count) == before
