"""``cbsr-qa run --resume``: a run that was interrupted is the run it would have been."""

import hashlib
import random
import re
import shlex
import shutil
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from command import cbsr_qa, document, refused
from killing import (
    BEGIN,
    BRIEF,
    assert_same,
    came_of,
    check_come_through,
    interrupted,
    killed,
    latest_run,
    left_alone,
    strike,
    trial,
    write_files,
)
from made_once import made_once
from pages import HOW_TO, commands, typed

import cbsr_qa as qa
from cbsr_qa.app.run import conclusion
from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.app.run.run import run_sensor
from cbsr_qa.domain.errors import UnconcludedError
from cbsr_qa.store.opening import open_store


@pytest.fixture(scope="module")
def whole():
    """A folder with a run that was left alone."""

    def make(folder):
        write_files(folder)
        cbsr_qa(folder, *BEGIN, "--serial", "whole")

    folder = made_once("run left alone", make)
    return folder, came_of(folder, latest_run(folder, "whole"))


@pytest.fixture(scope="module")
def left_behind():
    """A folder as a run left it that was killed in its second phase; nobody opens its database."""

    def make(folder):
        write_files(folder)
        assert killed(folder, [*BEGIN, "--serial", "S-1", "--operator", "Kim"], documents=200, after_s=0.0)

    return made_once("run killed", make)


@pytest.fixture
def cut_off(left_behind, tmp_path):
    """A folder with a run that was killed in its second phase."""
    shutil.copytree(left_behind, tmp_path, dirs_exist_ok=True, ignore=shutil.ignore_patterns("*.sock"))
    return tmp_path, latest_run(tmp_path, "S-1")


@pytest.mark.rest
@pytest.mark.parametrize("seed", range(2))
def test_a_run_that_is_killed_twice_and_resumed_is_the_same_in_every_bit(whole, tmp_path, seed):
    write_files(tmp_path)
    came = trial(tmp_path, "S-1", whole[1], random.Random(seed))
    assert len(came.record.sessions) == 3


def test_a_run_that_was_cut_off_is_listed_resumed_and_then_refused(cut_off, whole):
    folder, run = cut_off
    (listed,) = document(cbsr_qa(folder, "db", "status", "--json"))["incomplete"]
    assert (listed["run"], listed["serial"], listed["phase"], listed["state"]) == (
        run,
        "S-1",
        "four places",
        "cut off",
    )
    assert "press" in listed["next"]
    assert "at (" in listed["next"]
    listed = " ".join(cbsr_qa(folder, "db", "status").stdout.split())
    assert re.search(rf"incomplete S-1, 20\S+ \S+ UTC \({run}\): cut off in 'four places'", listed)
    resumed = document(cbsr_qa(folder, "run", "--resume", run, "--operator", "Jo", "--json"))
    assert (resumed["run"], resumed["serial"], resumed["end"], resumed["resume"]) == (run, "S-1", "finished", None)
    came = came_of(folder, run)
    assert_same(whole[1], came)
    first, second = came.record.sessions
    assert (first.operator, first.ended_s, second.operator, str(second.end)) == ("Kim", None, "Jo", "finished")
    assert document(cbsr_qa(folder, "db", "status", "--json"))["incomplete"] == []
    report = (folder / resumed["report"]).read_text(encoding="utf-8")
    assert "cut off" in report
    assert "resumed by Jo" in report
    assert "is finished" in refused(folder, "run", "--resume", run)
    assert not list((folder / "var").glob("*.lock"))


def unchained(database):
    """Make runs as they were before chains."""
    database.execute("delete from run_links")
    database.execute("update runs set chain = null")


def configured(database, configuration):
    """Have runs begun with a configuration."""
    digest = hashlib.sha256(configuration.encode()).hexdigest()
    database.execute("update runs set configuration = ?, configuration_digest = ?", (configuration, digest))


def without_result(file, run):
    """Make a database as it was before a run's result was stored: the newest rows and links gone."""
    with sqlite3.connect(file) as database:
        tables = [
            name for (name,) in database.execute("select name from sqlite_master where name like 'calibration%'")
        ]
        for table in ("measurements", "warnings", "analyses", *(t for t in tables if not t.startswith("sqlite_"))):
            database.execute(f"delete from {table}")
        first = "select min(number) from run_links where kind = 'analyses'"
        database.execute(f"delete from run_links where run = ? and number >= ({first})", (run,))


@pytest.mark.rest
def test_a_run_killed_while_its_result_was_worked_out_is_concluded(cut_off):
    folder, run = cut_off
    cbsr_qa(folder, "run", "--resume", run)
    without_result(folder / "var" / "cbsr-qa.db", run)
    with sqlite3.connect(folder / "var" / "cbsr-qa.db") as database:
        (frames,) = database.execute("select count(*) from frame_blocks").fetchone()
    status = document(cbsr_qa(folder, "db", "status", "--json"))
    assert status["without_result"] == [{"run": run, "serial": "S-1"}]
    resumed = document(cbsr_qa(folder, "run", "--resume", run, "--json"))
    assert (resumed["end"], resumed["outcome"]) == ("finished", "pass")
    with sqlite3.connect(folder / "var" / "cbsr-qa.db") as database:
        assert database.execute("select count(*) from frame_blocks").fetchone() == (frames,)


@pytest.mark.rest
@pytest.mark.parametrize("chained", [True, False], ids=["chained", "unchained"])
def test_a_report_over_measurements_that_were_changed_is_refused(whole, tmp_path, chained):
    shutil.copytree(whole[0], tmp_path, dirs_exist_ok=True)
    for report in (tmp_path / "var" / "reports").iterdir():
        report.unlink()
    with sqlite3.connect(tmp_path / "var" / "cbsr-qa.db") as database:
        if not chained:
            unchained(database)
    said = cbsr_qa(tmp_path, "report", "whole").stdout
    assert ("chained by digests, not signed" if chained else "it was removed; changes cannot be detected") in said
    with sqlite3.connect(tmp_path / "var" / "cbsr-qa.db") as database:
        database.execute("update measurements set outcome = 'fail' where limited")
    before = {path: path.read_bytes() for path in (tmp_path / "var" / "reports").iterdir()}
    for command in (("report", "whole"), ("verdict", "override", latest_run(tmp_path, "whole"), "--outcome", "pass",
                                          "--by", "Kim", "--why", "so")):  # fmt: skip
        expected = "measurements (analysis" if chained else "states fail; its value"
        assert expected in refused(tmp_path, *command)
    assert before == {path: path.read_bytes() for path in (tmp_path / "var" / "reports").iterdir()}


@pytest.mark.rest
@pytest.mark.parametrize("measured", [True, False], ids=["not concluded", "cut off"])
@pytest.mark.parametrize("chained", [True, False], ids=["chained", "unchained"])
def test_a_run_whose_limit_was_loosened_is_not_resumed(cut_off, whole, tmp_path_factory, measured, chained):
    folder, run = cut_off
    if measured:
        folder = tmp_path_factory.mktemp("loosened")
        shutil.copytree(whole[0], folder, dirs_exist_ok=True)
        shutil.rmtree(folder / "var" / "calibrations")
        run = latest_run(folder, "whole")
        without_result(folder / "var" / "cbsr-qa.db", run)
    with sqlite3.connect(folder / "var" / "cbsr-qa.db") as database:
        looser = "update runs set configuration = replace(configuration, '\"upper\":6.5', '\"upper\":66.5')"
        database.execute(looser)
        assert database.execute("select count(*) from runs where configuration like '%66.5%'").fetchone() == (1,)
        if not chained:
            unchained(database)
    assert "its configuration is not the one it was begun with" in refused(folder, "run", "--resume", run)
    assert not list((folder / "var").glob("calibrations/*"))


@pytest.mark.rest
@pytest.mark.parametrize(
    ("at", "again", "stop", "database"),
    [
        ("evaluate_run", "cbsr-qa run --resume", signal.SIGINT, None),
        ("evaluate_run", "cbsr-qa run --resume", signal.SIGTERM, "of another line.db"),
        ("write_outputs", "cbsr-qa report", signal.SIGQUIT, "of another line.db"),
    ],
)
def test_a_signal_while_the_result_is_worked_out_says_how_to_have_it(
    tmp_path, monkeypatch, at, again, stop, database
):
    write_files(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CBSR_QA_VAR", "var")

    def stopped(*_, **__):
        signal.raise_signal(stop)

    with monkeypatch.context() as patch:
        patch.setattr(conclusion, at, stopped)
        with pytest.raises(UnconcludedError, match="all measured data is stored") as ended:
            run_sensor(RunRequest("station.toml", "recipe.toml", "S-1", seed=5, database=database))
    assert ended.value.exit_code == 3
    assert f"stopped by signal {stop.name} while" in ended.value.reason
    run = ended.value.document()["aborted"]["run"]
    command = f"{again} {run}" + ("" if database is None else f" --database '{database}'")
    assert ended.value.remedy == f"to continue: {command}"
    done = document(cbsr_qa(tmp_path, *shlex.split(command)[1:], "--json"))
    assert Path(tmp_path / done["report"]).exists()
    assert len(came_of(tmp_path, run, database or "var/cbsr-qa.db").record.sessions) == 1


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--batch", "B-1"], "--batch cannot be given with --resume"),
        (["--seed", "1", "--dry-run"], "--seed, --dry-run cannot be given with --resume"),
        (["--serial", ""], "--serial cannot be given with --resume"),
    ],
)
def test_a_run_is_resumed_as_it_was_begun(tmp_path, more, said):
    assert said in refused(tmp_path, "run", "--resume", "x", *more)
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_run_is_refused_and_nothing_is_made(tmp_path):
    said = refused(tmp_path, "run", "--resume", "no-such-run")
    assert "does not exist or is empty" in said
    assert "--database" in said
    cbsr_qa(tmp_path, "db", "upgrade")
    said = refused(tmp_path, "run", "--resume", "no-such-run")
    for words in ("no run 'no-such-run' in this database", "cbsr-qa db status", "--database"):
        assert words in said
    assert [path.name for path in (tmp_path / "var").iterdir()] == ["cbsr-qa.db"]


def test_a_new_run_still_needs_station_recipe_and_serial(tmp_path):
    assert "--recipe" in refused(tmp_path, "run", "--station", "simulated", "--serial", "A")


@pytest.mark.rest
def test_a_missing_plugin_is_refused_and_other_software_is_said(cut_off):
    folder, run = cut_off
    path = folder / "var" / "cbsr-qa.db"
    with sqlite3.connect(path) as database:
        (configuration,) = database.execute("select configuration from runs").fetchone()
        other = configuration.replace("location-grid", "location-grit")
        unchained(database)
        configured(database, other)
        database.execute("""update runs set software = '[["cbsr-qa", "0.0.1"], ["numpy", "1.0"]]'""")
    assert "location-grit" in refused(folder, "run", "--resume", run)
    with sqlite3.connect(path) as database:
        assert database.execute("select count(*) from run_states").fetchone() == (1,)
        configured(database, configuration)
    resumed = document(cbsr_qa(folder, "run", "--resume", run, "--json"))
    (warning,) = [one for one in resumed["warnings"] if "other software" in one]
    assert any("it was removed; changes cannot be detected" in one for one in resumed["warnings"])
    assert "it was removed; changes cannot be detected" in (folder / resumed["report"]).read_text(encoding="utf-8")
    assert "cbsr-qa 0.0.1 →" in warning
    assert "numpy 1.0 →" in warning


@pytest.mark.rest
def test_an_aborted_run_is_told_apart_and_resumed(tmp_path, whole):
    """SIGTERM in the middle: the run ends in order, and goes on."""
    write_files(tmp_path)
    script = """
import os, signal, sys
from cbsr_qa.store.runs.journal import Journal
stored, count = Journal.__call__, 0
def counted(self, event):
    global count
    stored(self, event)
    count += 1
    if count == 90:
        os.kill(os.getpid(), signal.SIGTERM)
Journal.__call__ = counted
from cbsr_qa.cli.main import run_guarded
sys.exit(run_guarded(sys.argv[1:]))
"""
    done = subprocess.run(
        [sys.executable, "-c", script, *BEGIN, "--serial", "S-1"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    aborted = document(done)
    assert (done.returncode, aborted["end"]) == (3, "aborted")
    assert aborted["resume"] == f"cbsr-qa run --resume {aborted['run']}"
    status = document(cbsr_qa(tmp_path, "db", "status", "--json"))
    assert status["incomplete"] == []
    assert [(one["run"], one["end"]) for one in status["stopped"]] == [(aborted["run"], "aborted")]
    cbsr_qa(tmp_path, "run", "--resume", aborted["run"])
    came = came_of(tmp_path, aborted["run"])
    assert_same(whole[1], came)
    assert [str(session.end) for session in came.record.sessions] == ["aborted", "finished"]


@pytest.mark.rest
def test_with_memory_effects_a_resumed_run_agrees_within_noise(tmp_path):
    """The mean steady frame of each load: the difference of two is noise of √2 σ/√4 a reading, and residues of
    earlier presses, which rests of other lengths leave different. The bound: 5 of these σ on any of 256 readings of
    six loads would be met by noise in one of 900 trials; relaxed residues may add as much again."""
    write_files(tmp_path, memory=True)
    runs = []
    for serial, cut in (("A", None), ("B", 170)):
        arguments = [*BEGIN, "--serial", serial]
        if cut is None:
            cbsr_qa(tmp_path, *arguments)
        else:
            assert killed(tmp_path, arguments, documents=cut, after_s=0.0)
            cbsr_qa(tmp_path, "run", "--resume", latest_run(tmp_path, serial))
        runs.append(came_of(tmp_path, latest_run(tmp_path, serial)).record)
    sigma = np.std(
        runs[0].phases[0].frames.select_interval(0.0, runs[0].phases[0].loads[0].press_start_s).voltages, axis=0
    )
    for phase, other in zip(*(run.phases for run in runs), strict=True):
        for load, again in zip(phase.loads, other.loads, strict=True):
            steady = [
                of.frames.select_interval(one.hold_start_s, one.release_start_s).voltages[-4:].mean(axis=0)
                for of, one in ((phase, load), (other, again))
            ]
            assert np.abs(steady[0] - steady[1]).max() < 2 * 5 * np.sqrt(2 / 4) * sigma.mean()


@pytest.mark.rest
def test_the_page_on_what_to_do_runs_as_printed(cut_off):
    folder, run = cut_off
    lines = commands(HOW_TO / "what-to-do-when-it-stops.md")
    assert len(lines) == 3
    said = [" ".join(typed(folder, line.replace("RUN", run)).stdout.split()) for line in lines]
    assert f"({run}): cut off" in said[0]
    assert "cbsr-qa run --resume RUN" in said[0]
    assert said[1].startswith("✓ PASS")


@pytest.mark.rest
def test_a_second_program_is_told_who_writes_the_run(cut_off):
    folder, run = cut_off
    with open_store(f"sqlite:///{folder / 'var' / 'cbsr-qa.db'}") as store, store.claims.hold_run(run, "Alex"):
        assert "is being written by Alex on" in refused(folder, "run", "--resume", run)
        status = document(cbsr_qa(folder, "db", "status", "--json"))
    assert status["incomplete"][0]["state"].startswith("under way: Alex on")


@pytest.fixture(scope="module")
def brief(tmp_path_factory):
    """What came of a brief run that was left alone, and its number of moments."""
    return left_alone(tmp_path_factory.mktemp("brief"))


def check_named_without_result(folder, run):
    """Whatever shows one run says that it has no result and how it gets one; nothing reads like a verdict."""
    how = f"no result is stored; to compute and store it: cbsr-qa run --resume {run}"
    shown = cbsr_qa(folder, "report", run, check=False)
    assert shown.returncode == 3
    assert " ".join(shown.stdout.split()).startswith(f"? NOT MEASURED: {how}")
    assert not {"✓", "PASS", "pass"} & {*shown.stdout.split()}
    said = cbsr_qa(folder, "report", run, "--json", check=False)
    told = document(said)
    assert (said.returncode, told["outcome"], told["reason"]) == (3, "not measured", how)
    page = Path(folder, told["report"]).read_text()
    assert how in page
    assert "✓" not in page
    assert "PASS" not in page
    shown_in_python = qa.Run(run, str(folder / "var" / "cbsr-qa.db"))
    assert (shown_in_python.verdict, shown_in_python.result.exit_code) == (None, 3)
    assert shown_in_python.result.reason.startswith("no result is stored")
    assert f"cbsr-qa run --resume {run}" in shown_in_python.result.resume
    exported = folder / "frames.nc"
    cbsr_qa(folder, "export", run, "--to", exported)
    with h5py.File(exported) as file:
        assert file.attrs["verdict"] == "none"


@pytest.mark.rest
def test_a_run_that_was_stopped_resumed_and_killed_while_it_was_computed_gets_its_result(brief, tmp_path):
    write_files(tmp_path, recipe=BRIEF)
    assert strike(tmp_path, [*BEGIN, "--serial", "S-1"], at=60, number=signal.SIGTERM).code == 3
    run = latest_run(tmp_path, "S-1")
    resume = ["run", "--resume", run, "--json"]
    killed_there = strike(tmp_path, resume, at="imaging", number=signal.SIGKILL)
    assert "the database holds no verdict" in killed_there.said
    assert f"continue with: cbsr-qa run --resume {run}" in killed_there.said
    (missing,) = document(cbsr_qa(tmp_path, "db", "status", "--json"))["without_result"]
    assert missing == {"run": run, "serial": "S-1"}
    listed = " ".join(cbsr_qa(tmp_path, "runs").stdout.split())
    assert "no result" in listed
    assert f"cbsr-qa run --resume {run}" in listed
    check_named_without_result(tmp_path, run)
    refused(tmp_path, "verdict", "override", run, "--outcome", "pass", "--by", "Kim", "--why", "as I say")
    assert strike(tmp_path, resume, at=-1, number=0).code == 0
    check_come_through(tmp_path, run, brief[0])


@pytest.mark.rest
def test_a_run_killed_once_its_result_is_stored_is_told_to_write_its_files(brief, tmp_path):
    write_files(tmp_path, recipe=BRIEF)
    cut = strike(tmp_path, [*BEGIN, "--serial", "S-1"], at="save done", number=signal.SIGKILL)
    run = latest_run(tmp_path, "S-1")
    assert cut.code == 3
    assert f"continue with: cbsr-qa report {run}" in cut.said
    cbsr_qa(tmp_path, "report", run)
    check_come_through(tmp_path, run, brief[0])


@pytest.mark.rest
@pytest.mark.parametrize("seed", range(3))
def test_a_run_struck_at_random_is_resumed_until_it_has_its_result(brief, tmp_path, seed):
    assert interrupted(tmp_path, *brief, random.Random(seed)) > 0
