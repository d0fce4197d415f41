"""Databases that cannot be used: each gives one clear message with what to do, and nothing is half-written."""

import re
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from later_schema import LATER, add_revision
from sqlalchemy import event
from stored_runs import CONFIGURATION, SETTING, frames, journalled, short_run

from cbsr_qa.app.database import database_status, upgrade_database
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.run.events import FramesTaken, RunEnded
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.report.document import json_document
from cbsr_qa.store import engine as engines, schema
from cbsr_qa.store.engine import open_engine, parse_url
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.runs.journal import Journal


@pytest.fixture
def path(tmp_path):
    return tmp_path / "runs.db"


@pytest.fixture
def filled(path):
    with open_store(f"sqlite:///{path}") as repository:
        journalled(repository, short_run("run-1"))
    return path


def refused(path, *, create=True):
    with pytest.raises(StoreError) as caught:
        open_store(f"sqlite:///{path}", create=create)
    assert str(path) in caught.value.reason
    assert caught.value.remedy
    assert caught.value.exit_code == 2
    return str(caught.value)


def test_a_missing_database_is_made_only_where_that_is_meant(path):
    assert "does not exist or is empty" in refused(path, create=False)
    assert not path.exists()
    open_store(f"sqlite:///{path}").close()
    assert path.exists()


def test_looking_does_not_make_one(path):
    status = database_status(str(path)).result
    assert (status.state, status.schema, status.counts, status.incomplete) == ("empty", None, {}, ())
    assert not path.exists()


def test_an_empty_file_becomes_a_database(path):
    path.touch()
    open_store(f"sqlite:///{path}").close()
    assert database_status(str(path)).result.state == "current"


def executed(*statements):
    """Have another program make a database, or change ours."""

    def execute(path):
        with closing(sqlite3.connect(path)) as other, other:
            for statement in statements:
                other.execute(statement)

    return execute


def cut_at(share):
    return lambda path: path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])


def misspelt(path):
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"tableruns", b"tableru\xffs"))
    assert path.read_bytes() != whole


FOREIGN = "is damaged or cut off|is not a database"
UNUSABLE = {
    "no database": (lambda path: path.write_text("time_pc [s],voltage [V]\n" * 100), "is not a database"),
    "cut off at 1 %": (cut_at(0.01), FOREIGN),
    "cut off at 30 %": (cut_at(0.3), FOREIGN),
    "cut off at 90 %": (cut_at(0.9), FOREIGN),
    "a schema that is no text": (misspelt, "is damaged or cut off"),
    "another program's": (
        lambda path: path.unlink() or executed("create table parts (number)")(path),
        "belongs to another program",
    ),
    "another program's with Alembic": (
        executed("drop table alembic_version", "create table alembic_version (version_num)",
                 "insert into alembic_version values ('abcdef')"),
        r"unknown to this program \(",
    ),
    "a newer one": (executed("update alembic_version set version_num = '9999'"), "schema 9999"),
}  # fmt: skip


@pytest.mark.parametrize(("spoil", "said"), UNUSABLE.values(), ids=UNUSABLE)
def test_a_file_that_cannot_be_used_is_named_and_left_alone(filled, spoil, said):
    spoil(filled)
    before = filled.read_bytes()
    assert re.search(said, refused(filled))
    with pytest.raises(StoreError, match=said):
        upgrade_database(str(filled))
    assert filled.read_bytes() == before


def test_a_file_system_that_makes_no_files_is_refused():
    if not Path("/proc/self").exists():
        pytest.skip("no /proc")
    with pytest.raises(StoreError, match="cannot create a lock file beside it"):
        open_store("sqlite:////proc/cbsr-qa-test.db")


def test_an_older_schema_says_what_to_run_and_running_it_helps(filled, tmp_path, monkeypatch):
    before = schema.HEAD
    add_revision(monkeypatch, tmp_path)
    assert "cbsr-qa db upgrade" in refused(filled)
    assert database_status(str(filled)).result.state == "older"
    done = upgrade_database(str(filled)).result
    assert (done.before, done.after, done.changed) == (before, LATER, True)
    with open_store(f"sqlite:///{filled}") as repository:
        assert len(repository.runs.load("run-1").phases[0].frames) == 9
    assert not upgrade_database(str(filled)).result.changed


def test_the_status_of_a_newer_schema_is_said(filled):
    executed("update alembic_version set version_num = '9999'")(filled)
    done = database_status(str(filled))
    assert (done.result.state, done.page.banner.symbol) == ("newer", "–")


def test_a_read_only_database_can_be_read_and_refuses_to_be_written(filled):
    url = f"sqlite:///file:{filled}?mode=ro&uri=true"
    with open_store(url) as repository:
        assert repository.runs.resolve("S-1") == "run-1"
        with pytest.raises(StoreError, match="is read-only"):
            journalled(repository, short_run("run-2", "S-2"))


def test_a_folder_in_place_of_a_file_and_one_that_cannot_be_made_are_named(tmp_path):
    (tmp_path / "runs.db").mkdir()
    assert "is a folder, not a database\nname a file in it" in refused(tmp_path / "runs.db")
    assert list((tmp_path / "runs.db").iterdir()) == []
    (tmp_path / "a file").touch()
    assert "a file is not a folder" in refused(tmp_path / "a file" / "runs.db")


def test_a_locked_database_says_so_after_waiting(filled, monkeypatch):
    monkeypatch.setattr(engines, "BUSY_TIMEOUT_MS", 20)
    with open_store(f"sqlite:///{filled}") as repository, sqlite3.connect(filled, isolation_level=None) as other:
        other.execute("begin immediate")
        with pytest.raises(StoreError, match="in use by another program"):
            journalled(repository, short_run("run-2"))
        assert repository.runs.resolve("S-1") == "run-1"  # readers do not wait for a writer
        other.execute("rollback")
        journalled(repository, short_run("run-2"))


def test_a_full_disk_keeps_what_was_committed_and_the_journal_goes_on_when_there_is_space(path):
    engine = open_engine(parse_url(f"sqlite:///{path}"))
    schema.upgrade(engine)
    journal = Journal(engine, configuration=CONFIGURATION, **SETTING)
    for told in short_run("run-1")[:5]:
        journal(told)
    pages, stored = [80], []
    event.listen(engine, "begin", lambda c: c.exec_driver_sql(f"PRAGMA max_page_count = {pages[0]}"))

    def measure_for_ever():
        while True:
            journal(FramesTaken(0, frames(10.0 + len(stored), seed=len(stored))))
            stored.append(len(stored))

    with pytest.raises(StoreError, match=r"disk is full") as caught:
        measure_for_ever()
    assert "everything committed so far is kept" in caught.value.remedy
    pages[0] = 1_000_000
    journal(FramesTaken(0, frames(9999.0)))
    engine.dispose()
    with open_store(f"sqlite:///{path}") as repository:
        kept = repository.runs.load("run-1").phases[0].frames
    assert stored
    assert kept.time_s.tolist() == [10.0 + number for number in stored] + [9999.0]


def test_an_upgrade_that_fails_half_way_changes_nothing(path, tmp_path, monkeypatch):
    engine = open_engine(parse_url(f"sqlite:///{path}"))
    schema.upgrade(engine)
    engine.dispose()
    made_by = schema.HEAD
    add_revision(monkeypatch, tmp_path)
    with sqlite3.connect(path) as other:
        other.execute("create table cases (in_the_way)")  # the migration makes another before it
        before = other.execute("select name from sqlite_master order by name").fetchall()
    with pytest.raises(StoreError, match="cases already exists"):
        upgrade_database(str(path))
    with sqlite3.connect(path) as other:
        assert other.execute("select name from sqlite_master order by name").fetchall() == before
        assert other.execute("select version_num from alembic_version").fetchone() == (made_by,)


@pytest.mark.parametrize("url", ["postgresql://u:geheim@:port/x", "mysql://u:geheim@host/x", "://geheim"])
def test_urls_that_cannot_be_used_are_refused_without_repeating_a_password(url):
    with pytest.raises(StoreError) as caught:
        open_store(url)
    assert "geheim" not in str(caught.value)
    assert caught.value.remedy


def test_a_server_that_does_not_answer_is_named_without_its_password():
    pytest.importorskip("psycopg")
    with pytest.raises(StoreError, match="does not answer") as caught:
        open_store("postgresql://u:geheim@127.0.0.1:1/x")
    assert "geheim" not in str(caught.value)


def test_the_status_document_tells_runs_that_were_cut_off_from_those_that_were_stopped(filled):
    with open_store(f"sqlite:///{filled}") as repository:
        journalled(repository, short_run("run-2")[:8])
        ended = RunEnded(EndReason.BROKEN, "rule 'force': 21 N measured", 160.0, ())
        journalled(repository, [*short_run("run-3")[:11], ended])
    document = json_document(database_status(str(filled)).result)
    assert document["url"] == str(filled)
    assert (document["schema"], document["head"]) == (schema.HEAD, schema.HEAD)
    assert document["counts"]["runs"] == 3
    where = {"serial": "S-1", "phase": "nine locations", "next": "press L0 at (15, -15) mm to 20 %, trial 1"}
    assert document["incomplete"] == [{"run": "run-2", **where, "state": "cut off"}]
    (stopped,) = document["stopped"]
    assert (stopped["run"], stopped["end"], stopped["detail"]) == ("run-3", "broken", "rule 'force': 21 N measured")


# --- a file that is taken away from a run ---


@pytest.mark.parametrize("how", ["deleted", "moved", "replaced"])
def test_a_run_does_not_go_on_in_a_file_that_is_gone(path, how):
    """SQLite itself would go on writing into it, and all of that would be gone with the last program that has it."""
    events = short_run("run-1")
    with open_store(f"sqlite:///{path}") as repository:
        journal = journalled(repository, events[:6])
        match how:
            case "deleted":
                path.unlink()
            case "moved":
                path.rename(path.with_name("elsewhere.db"))
            case "replaced":
                copy = path.with_name("copy.db")
                copy.write_bytes(path.read_bytes())
                copy.rename(path)
        with pytest.raises(StoreError, match="while it was in use") as refused:
            journal(events[6])
        assert ("replaced" if how == "replaced" else "deleted or moved") in refused.value.reason
        assert str(path) in refused.value.reason
        assert "-wal" in refused.value.remedy
        with pytest.raises(StoreError, match="while it was in use"):
            repository.runs.load("run-1")
    assert path.exists() == (how == "replaced")


def test_a_run_goes_on_in_a_file_that_was_put_back(path):
    events = short_run("run-1")
    with open_store(f"sqlite:///{path}") as repository:
        journal = journalled(repository, events[:6])
        aside = path.rename(path.with_name("elsewhere.db"))
        with pytest.raises(StoreError):
            journal(events[6])
        aside.rename(path)
        for event in events[6:]:
            journal(event)
        assert repository.runs.load("run-1").end is EndReason.FINISHED
