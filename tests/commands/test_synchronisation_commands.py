"""``cbsr-qa db sync`` as it is typed: what it prints, its exit codes, and no password anywhere."""

import json
import signal
import sqlite3
import subprocess

import pytest
import synced
from command import PROGRAM, cbsr_qa
from pages import HOW_TO, blocks, commands, typed

from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.store.opening import open_store


@pytest.fixture
def station(tmp_path):
    """A folder with a station's database and an empty central one."""
    with open_store(f"sqlite:///{tmp_path / 'station.db'}", durable=False) as store:
        synced.run_of(store)
    open_store(f"sqlite:///{tmp_path / 'centre.db'}").close()
    return tmp_path


def sync(folder, *options, check=False):
    return cbsr_qa(folder, "db", "sync", "--database", "station.db", *options, check=check)


def test_sending_and_looking(station):
    before = json.loads(sync(station, "--status", "--json").stdout)
    assert (before["waiting"], before["runs"]) == ({"run": 1}, 0)
    done = json.loads(sync(station, "--to", "centre.db", "--json").stdout)
    assert (done["runs"], done["waiting"], done["backlog_h"]) == (1, {}, None)
    again = sync(station, "--to", "centre.db")
    assert (again.returncode, "there was nothing to send" in again.stdout) == (0, True)


def test_a_backlog_that_is_too_old_is_a_failure(station):
    with sqlite3.connect(station / "station.db") as database:
        database.execute("UPDATE outbox SET noted_at = '2026-01-01 00:00:00'")
    assert sync(station, "--status").returncode == 0
    late = sync(station, "--status", "--limit-h", "24")
    assert (late.returncode, "older than 24 h" in " ".join(late.stdout.split())) == (1, True)


def test_a_quarantined_run_is_named_and_let_go_and_open_again_until_it_is_right(station):
    with sqlite3.connect(station / "station.db") as database:
        (run,) = database.execute("SELECT run FROM runs").fetchone()
        database.execute("UPDATE loads SET x_mm = 1.5")
    done = sync(station, "--to", "centre.db")
    assert done.returncode == 1
    assert "does not match its digest" in " ".join(done.stdout.split())
    listed = json.loads(sync(station, "--status", "--to", "centre.db", "--json").stdout)
    assert [one["item"] for one in (*listed["held"], *listed["refused"])] == [run, run]
    assert sync(station, "--let-go", run).returncode == 0
    assert refused(station) == [run]  # nobody has told the centre yet
    sync(station, "--to", "centre.db")
    assert refused(station) == []
    sync(station, "--retry", run, "--to", "centre.db")
    assert refused(station) == [run]
    with sqlite3.connect(station / "station.db") as database:
        database.execute("UPDATE loads SET x_mm = 15.0")
    assert "1 run" in sync(station, "--retry", run, "--to", "centre.db", check=True).stdout
    assert refused(station) == []
    assert "nothing named" in sync(station, "--retry", run).stderr


def test_what_was_altered_at_the_centre_is_found_when_it_is_compared(station):
    sync(station, "--to", "centre.db", check=True)
    with sqlite3.connect(station / "centre.db") as database:
        database.execute("UPDATE loads SET x_mm = 1.5")
    assert sync(station, "--to", "centre.db").returncode == 0  # nothing is announced
    done = sync(station, "--to", "centre.db", "--compare-since", "2026-11-01", "--json")
    (held,) = json.loads(done.stdout)["held"]
    assert (done.returncode, held["why"].startswith("at the centre, run ")) == (1, True)
    assert "cannot be given together" in sync(station, "--status", "--compare-since", "2026-11-01").stderr


def test_what_the_centre_had_lost_is_said_and_the_exit_code_is_1_once(station):
    sync(station, "--to", "centre.db", check=True)
    compare = ("--to", "centre.db", "--compare-since", "2026-11-01")
    for form in ((), ("--json",)):
        (station / "centre.db").unlink()
        open_store(f"sqlite:///{station / 'centre.db'}").close()
        done = sync(station, *compare, *form)
        assert done.returncode == 1
        assert ("did not have it" in " ".join(done.stdout.split()), "✓" in done.stdout) == (True, False)
        assert "PASS" not in done.stdout
    (lost,) = json.loads(done.stdout)["lost"]
    with sqlite3.connect(station / "station.db") as database:
        assert database.execute("SELECT run FROM runs").fetchall() == [(lost["item"],)]
    assert json.loads(sync(station, *compare, "--json", check=True).stdout)["lost"] == []


@pytest.mark.parametrize("place", ["station.db", "centre.db"])
def test_the_name_of_a_held_run_is_said_once(station, place):
    sync(station, "--to", "centre.db", check=True)
    with sqlite3.connect(station / place) as database:
        (run,) = database.execute("SELECT run FROM runs").fetchone()
        database.execute("UPDATE loads SET x_mm = 1.5")
    sync(station, "--to", "centre.db", "--compare-since", "2026-11-01")
    shown = sync(station, "--status", "--to", "centre.db").stdout
    assert shown.count(run) == 2  # quarantined here, and refused there
    assert shown.count("was changed") == 2


def refused(folder):
    status = json.loads(sync(folder, "--status", "--to", "centre.db", "--json").stdout)
    return [one["item"] for one in status["refused"]]


def test_a_watch_waits_for_a_database_and_for_the_centre_and_says_so(station):
    (station / "station.db").rename(station / "later.db")
    (station / "centre.db").rename(station / "offline.db")
    command = [PROGRAM, "db", "sync", "--database", "station.db", "--to", "centre.db"]
    pipes = {"stderr": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([*command, "--watch", "1"], cwd=station, **pipes) as watch:
        said = iter(watch.stderr.readline, "")
        assert "station.db does not exist" in heard(said, "trying again")
        (station / "later.db").rename(station / "station.db")
        assert "centre.db does not exist or is empty; 1 item waits" in heard(said, "trying again")
        (station / "offline.db").rename(station / "centre.db")
        assert "1 run" in heard(said, "sent")
        watch.send_signal(signal.SIGINT)
        out, _ = watch.communicate(timeout=60)
    assert (watch.returncode, "sent: 1 run" in " ".join(out.split())) == (0, True)


def heard(lines, word):
    return next(line for line in lines if word in line)


def test_a_station_file_names_the_centre_and_the_limit(station):
    text = open_document(DocumentKind.STATION, "simulated").text
    (station / "bench.toml").write_text(f'{text}\n[sync]\ncentre = "sqlite:///centre.db"\nbacklog_hours = 24\n')
    with sqlite3.connect(station / "station.db") as database:
        database.execute("UPDATE outbox SET noted_at = '2026-01-01 00:00:00'")
    late = json.loads(sync(station, "--status", "--station", "bench.toml", "--json").stdout)
    assert (late["limit_h"], late["late"]) == (24, True)
    assert json.loads(sync(station, "--station", "bench.toml", "--json").stdout)["runs"] == 1


@pytest.mark.parametrize(
    ("to", "words"),
    [
        ("postgresql://u:hidden-word@127.0.0.1:1/quality", "does not answer"),
        ("postgresql://127.0.0.1:1/quality?user=u&password=hidden-word", "does not answer"),
        ("postgresql://u:hidden-word@[::1/quality", "cannot be read"),
        ("centre.db", "does not exist or is empty"),
        ("station.db", "is the station's own"),
    ],
)
def test_a_centre_that_cannot_be_used_is_named_without_its_password(station, to, words):
    (station / "centre.db").unlink()
    done = sync(station, "--to", to)
    assert done.returncode == 2
    assert words in done.stderr
    status = sync(station, "--status", "--to", to)
    assert not (station / "centre.db").exists()
    if "cannot be read" not in words:
        assert "1 item waits in this database" in done.stderr
        assert "1 item waits in this database" in status.stdout
        assert (status.returncode, words in " ".join(status.stdout.split())) == (0, True)
    assert "hidden-word" not in done.stdout + done.stderr + status.stdout + status.stderr


def test_options_that_contradict_each_other_are_refused(station):
    assert "cannot be given together" in sync(station, "--status", "--watch", "5").stderr
    assert "no central database is named" in sync(station).stderr


@pytest.mark.rest
@pytest.mark.postgres
def test_the_page_on_the_central_database_runs_as_printed(tmp_path, postgres_database):
    page = HOW_TO / "central-database.md"
    named = "postgresql://postgres@127.0.0.1:5432/quality"
    create, export = (block.strip() for block in blocks(page, "sh"))
    upgrade = create.splitlines()[1].replace(named, postgres_database)
    typed(tmp_path, upgrade)
    name, value = export.removeprefix("export ").split("=")
    assert value == named
    said = (typed(tmp_path, line, **{name: postgres_database}).stdout for line in commands(page))
    _, sent, status, compared = said
    assert "1 run" in sent
    assert "nothing waits" in status
    assert "1 run compared at both ends" in compared
