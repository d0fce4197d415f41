"""The fleet of the demonstration: its designs, its truth, and that it says what it is."""

import os
import shutil
import sqlite3
import subprocess
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from demo_fleet import demo_fleet

from cbsr_qa.app.run.render import render_stored
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies import fleet_demo
from cbsr_qa.studies.fleet_demo import DRAWN, ONE_STATION, REPEATED, SAID, THIRD_ON_ALL, build_fleet, yield_runs

TOP = Path(__file__).parents[2]

pytestmark = pytest.mark.rest


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The database, and what was counted while it was built."""
    file, counted = demo_fleet()
    return shutil.copy(file, tmp_path_factory.mktemp("fleet")), counted


def test_the_first_design_has_each_sensor_at_one_station_the_second_a_third_at_all():
    for recipe, runs, everywhere in ((ONE_STATION, 60, 0), (THIRD_ON_ALL, 102, 21)):
        stations = {}
        for run in yield_runs():
            if run.recipe == recipe:
                stations.setdefault((run.batch, run.sensor), set()).add(run.station)
        assert len(stations) == 60
        assert Counter(len(found) for found in stations.values()) == Counter({1: 60 - everywhere, 3: everywhere})
        assert sum(len(found) for found in stations.values()) == runs
        once = [(batch, *found) for (batch, _), found in stations.items() if len(found) == 1]
        at_home = sum(batch == station for batch, station in once)
        assert 0.5 < at_home / len(once) < 0.7


def test_progress_is_told_run_by_run(built):
    assert built[1] == [[done, 198] for done in range(1, 199)]


def test_batch_and_station_differ_by_one_and_a_half_deviations(built):
    with open_store(f"sqlite:///{built[0]}", create=False) as store:
        table = store.fleet.load_table(RunSelection(recipe=ONE_STATION))
    errors = [i for i, kind in enumerate(table.kinds) if kind.key.name == "centre_of_mass_error"]
    taken = np.isin(table.kind, errors)
    means = {run: np.mean(table.value[taken & (table.run == i)]) for i, run in enumerate(table.runs)}
    rows = np.array([(1, run.batch == "43", run.station == "station-B") for run in means], float)
    (_, batch, station), (left,), *_ = np.linalg.lstsq(rows, np.array(list(means.values())), rcond=None)
    spread = np.sqrt(left / (len(rows) - 3))
    metric = DRAWN[0]
    assert spread == pytest.approx(np.hypot(metric.sensor, metric.run), rel=0.3)
    for found in (batch, station):
        assert found == pytest.approx(1.5 * metric.sensor, abs=3 * spread * np.sqrt(2 / 20))


def test_a_gauge_can_be_studied(built, printed):
    """The station adds 1.5 deviations between sensors at one of three stations; runs repeat within 0.12 mm."""
    asked = ["gauge", "--recipe", REPEATED, "--database", built[0], "--metric", "centre_of_mass_error"]
    (metric,) = printed(*asked)["metrics"]
    assert (len(metric["sensors"]), len(metric["appraisers"]), metric["trials"]) == (6, 3, 2)
    parts, drawn = metric["anova"]["components"], DRAWN[0]
    low, high = parts["repeatability"]["variance_interval"]
    # The mean over nine places adds its own scatter.
    assert low <= drawn.run**2 + drawn.place**2 / 9 <= high
    low, high = parts["reproducibility"]["variance_interval"]
    assert low <= (drawn.station * drawn.sensor) ** 2 / 3 <= high


def test_everything_says_that_nothing_was_measured(built, tmp_path):
    with open_store(f"sqlite:///{built[0]}", create=False) as store:
        runs = store.runs.find()
        record = store.runs.load(runs[0].run)
        assert all(run.outcome in (Outcome.PASS, Outcome.MARGINAL, Outcome.FAIL) for run in runs)
        assert store.changes.list_all() == ()
    assert record.identity.simulated == (SAID,)
    assert all(phase.frames is None for phase in record.phases)
    began = [run.started_at for run in reversed(runs)]
    assert all(earlier < later for earlier, later in pairwise(began))
    page = render_stored(runs[0].run, database=str(built[0]), folder=tmp_path).report.read_text()
    assert SAID in page
    assert "the run holds no frames" in page


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
@pytest.mark.parametrize(("system", "display", "opened"), [("Linux", "", 0), ("Linux", ":0", 2), ("Darwin", "", 2)])
def test_make_fleet_demo_opens_the_pages_where_there_is_a_screen_and_needs_no_browser(
    tmp_path, system, display, opened
):
    """The commands it runs are stand-ins that note how they were called; the one that opens pages fails."""
    called, binaries, var = tmp_path / "called", tmp_path / "venv" / "bin", tmp_path / "a folder"
    binaries.mkdir(parents=True), var.mkdir()
    for name, line in (
        ("python", f'echo "$@" >> "{called}"; [ "$2" != webbrowser ]'),
        ("cbsr-qa", f'echo "$@" >> "{called}"'),
        ("uname", f"echo {system}"),
    ):
        (binaries / name).write_text(f"#!/bin/sh\n{line}\n")
        (binaries / name).chmod(0o755)
    (tmp_path / "venv" / ".run-stamp").touch()
    environment = {"PATH": f"{binaries}:{os.environ['PATH']}", "CBSR_QA_VAR": str(var), "DISPLAY": display}
    command = ["make", "-C", str(TOP), "fleet-demo", f"VENV={binaries.parent}"]
    made = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    lines = called.read_text().splitlines()
    assert lines[0] == "-m cbsr_qa.cli.studies.fleet_demo"
    pages = [f"{var}/fleet-demo-{design}.html" for design in (ONE_STATION, THIRD_ON_ALL)]
    assert [line.split(" --output ")[1] for line in lines if line.startswith("compare")] == pages
    shown = [f"-m webbrowser file://{Path(page).resolve()}" for page in pages]
    assert [line for line in lines if "webbrowser" in line] == shown[:opened]


def test_a_fleet_is_replaced_and_anything_else_is_not(built, tmp_path, monkeypatch):
    path = tmp_path / "fleet-demo.db"
    shutil.copy(built[0], path)
    few = tuple(yield_runs())[:3]
    monkeypatch.setattr(fleet_demo, "yield_runs", lambda: few)
    build_fleet(path=path)
    with open_store(f"sqlite:///{path}", create=False) as store:
        run = store.runs.find()[0].run
        assert store.count_rows()["runs"] == 3
    with sqlite3.connect(path) as database:
        database.execute("UPDATE runs SET recipe = 'nine-locations' WHERE run = ?", (run,))
    database.close()
    with pytest.raises(RefusedError, match=f"not of the demonstration, e.g. {run}"):
        build_fleet(path=path)
    assert path.exists()
