"""Backups are consistent, verified, and whole or not there; restoring replaces nothing that is used."""

import os
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from datetime import date

import pytest
from later_schema import LATER, add_revision
from stored_runs import journalled, short_run

from cbsr_qa.app.database import upgrade_database
from cbsr_qa.app.keeping import back_up, check_database, restore_backup
from cbsr_qa.domain.errors import RefusedError, StoreError
from cbsr_qa.store import copies, schema
from cbsr_qa.store.engine import open_engine, parse_url, writing
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.schema import HEAD, read_version


def quiet(what, done, of):
    pass


def url(path):
    return f"sqlite:///{path}"


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    path = tmp_path_factory.mktemp("kept") / "runs.db"
    with open_store(url(path)) as store:
        for serial in ("S-1", "S-2"):
            journalled(store, short_run(store.new_id(), serial))
    return path


@pytest.fixture
def database(filled, tmp_path):
    return shutil.copy(filled, tmp_path / "runs.db")


def runs(path):
    with open_store(url(path), create=False) as store:
        return [run.serial for run in store.runs.find()]


def edit(path, statement):
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.executescript(statement)


def files(folder):
    return sorted(path.name for path in folder.iterdir() if not path.name.endswith((".lock", "-wal", "-shm")))


def test_a_backup_has_all_runs_and_is_one_file(database, tmp_path):
    stages = []
    done = back_up(str(database), tmp_path / "b.db", lambda what, done, of: stages.append(what)).result
    assert (done.schema, done.size_bytes) == (HEAD, (tmp_path / "b.db").stat().st_size)
    assert {"copying", "verifying"} <= set(stages)
    assert files(tmp_path) == ["b.db", "runs.db"]
    assert not (tmp_path / "b.db-wal").exists()
    assert runs(tmp_path / "b.db") == ["S-2", "S-1"]
    with pytest.raises(RefusedError, match="exists already"):
        back_up(str(database), tmp_path / "b.db", quiet)


def test_a_backup_is_one_state_while_a_run_is_written(database, tmp_path, monkeypatch):
    monkeypatch.setattr(copies, "_PAGES", 4)
    written = []
    with open_store(url(database)) as store:
        events = iter(short_run(run := store.new_id(), "S-3"))
        write = journalled(store, [next(events)])

        def count(what, done, of):
            if what == "copying" and (event := next(events, None)) is not None:
                write(event)
                written.append(event)

        back_up(str(database), tmp_path / "b.db", count)
        for event in events:
            write(event)
        store.runs.load(run)
    assert len(written) > 3
    with open_store(url(tmp_path / "b.db"), create=False) as copy:
        assert [one.serial for one in copy.runs.find()] == ["S-3", "S-2", "S-1"]
        copy.soundness.check_run(run, frames=True)
        assert not copy.runs.load(run).phases  # as it was when the backup began
    assert check_database(str(database), None, quiet, quick=False).exit_code == 0


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (sqlite3.OperationalError("database or disk is full"), "the disk is full"),
        (OSError(30, "Read-only file system"), "Read-only file system"),
    ],
)
def test_a_backup_that_cannot_be_finished_is_not_there(database, tmp_path, fault, said):
    def fail(what, done, of):
        raise fault

    with pytest.raises(RefusedError, match=said) as refused:
        back_up(str(database), tmp_path / "b.db", fail)
    assert refused.value.remedy
    assert files(tmp_path) == ["runs.db"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root mounts")
def test_a_full_disk_leaves_no_file(database, tmp_path):
    small = tmp_path / "small"
    small.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", small], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("no tmpfs can be mounted here")
    try:
        with pytest.raises(StoreError, match="disk is full"):
            back_up(str(database), small / "b.db", quiet)
        assert list(small.iterdir()) == []
    finally:
        subprocess.run(["umount", small], check=True)


def test_a_copy_that_differs_is_not_named(database, tmp_path, monkeypatch):
    heads = copies._heads
    monkeypatch.setattr(copies, "_heads", lambda connection: heads(connection) | {"x": str(id(connection))})
    with pytest.raises(StoreError, match="run x in it has another chain"):
        back_up(str(database), tmp_path / "b.db", quiet)
    assert files(tmp_path) == ["runs.db"]


def test_a_servers_database_is_left_to_its_tools():
    engine = open_engine(parse_url("postgresql://ada:secret@host:5432/name?password=secret"))
    with pytest.raises(RefusedError) as refused:
        copies.copy_database(engine, None)
    assert "pg_dump --format=custom --file=FILE --dbname='postgresql://ada@host:5432/name'" in refused.value.remedy
    assert "secret" not in str(refused.value)


def test_a_restored_backup_is_in_the_place_and_the_old_file_beside_it(database, tmp_path):
    back_up(str(database), tmp_path / "b.db", quiet)
    with open_store(url(database)) as store:
        journalled(store, short_run(store.new_id(), "S-3"))
    done = restore_backup(str(database), tmp_path / "b.db", quiet).result
    assert runs(database) == ["S-2", "S-1"]
    assert runs(done.replaced) == ["S-3", "S-2", "S-1"]
    with closing(sqlite3.connect(database)) as connection:
        assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)


def test_a_backup_is_restored_in_place_of_a_damaged_or_missing_database(database, tmp_path):
    back_up(str(database), tmp_path / "b.db", quiet)
    database.write_bytes(b"nothing")
    kept = restore_backup(str(database), tmp_path / "b.db", quiet).result.replaced
    assert kept.read_bytes() == b"nothing"
    database.unlink()
    assert restore_backup(str(database), tmp_path / "b.db", quiet).result.replaced is None
    assert runs(database) == ["S-2", "S-1"]


_READER = """
import sqlite3, sys
connection = sqlite3.connect(sys.argv[1])
connection.execute("SELECT count(*) FROM runs").fetchone()
print("reading", flush=True)
sys.stdin.read()
"""


def test_a_database_that_is_used_is_not_replaced(database, tmp_path):
    back_up(str(database), tmp_path / "b.db", quiet)
    before = database.read_bytes()
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", _READER, database], **pipes) as reader:
        assert reader.stdout.readline() == "reading\n"
        with pytest.raises(StoreError, match="has it open; the database is unchanged"):
            restore_backup(str(database), tmp_path / "b.db", quiet)
        reader.stdin.close()
    with (
        open_store(url(database)) as store,
        store.claims.hold_run("a-run", "Zoë"),
        pytest.raises(StoreError, match="a-run is held by Zoë"),
    ):
        restore_backup(str(database), tmp_path / "b.db", quiet)
    assert database.read_bytes() == before
    assert files(tmp_path) == ["b.db", "runs.db"]


def damaged(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2 :] = bytes(len(content) - len(content) // 2)
    path.write_bytes(content)


UNUSABLE = {
    "damaged": (damaged, "cannot be restored: it is damaged"),
    "cut off": (lambda path: os.truncate(path, path.stat().st_size // 2), "cannot be restored: it is damaged"),
    "another file": (lambda path: path.write_text("x" * 5000), "is not a database"),
    "newer": (lambda path: edit(path, "update alembic_version set version_num = '9999'"), "has schema 9999"),
    "another program's": (lambda path: edit(path, "drop table alembic_version"), "belongs to another program"),
    "missing": (lambda path: path.unlink(), "cannot be restored: No such file"),
}


@pytest.mark.parametrize(("spoil", "said"), UNUSABLE.values(), ids=UNUSABLE)
def test_an_unusable_backup_changes_nothing(database, tmp_path, spoil, said):
    back_up(str(database), tmp_path / "b.db", quiet)
    spoil(tmp_path / "b.db")
    before = database.read_bytes()
    with pytest.raises(RefusedError, match=said) as refused:
        restore_backup(str(database), tmp_path / "b.db", quiet)
    assert "the database is unchanged" in refused.value.reason
    assert database.read_bytes() == before
    assert not list(tmp_path.glob("*replaced*"))


def test_an_upgrade_is_undone_by_its_backup(tmp_path, database, monkeypatch):
    old = tmp_path / "old.db"
    engine = open_engine(parse_url(url(old)))
    schema.upgrade(engine)
    add_revision(monkeypatch, tmp_path)
    done = upgrade_database(str(old))
    assert (done.result.before, done.result.after) == (HEAD, LATER)
    backup = done.result.backup
    assert backup.name.startswith(f"old-schema-{HEAD}-")
    assert f"cbsr-qa db restore {backup}" in dict(done.page.printed)["Undone by"]
    engine.dispose()
    restored = restore_backup(str(old), backup, quiet)
    assert restored.result.schema == HEAD == read_version(engine).revision
    assert "cbsr-qa db upgrade" in dict(restored.page.printed)["Go on with"]
    engine.dispose()
    assert upgrade_database(str(old), backup=False).result.backup is None
    assert upgrade_database(str(old)).result.backup is None  # it is up to date


EDITS = {
    "a frame": (
        "update frame_blocks set voltages = zeroblob(length(voltages)) where rowid = 1",
        "frame block 0 of phase 0",
        False,
    ),
    "a load": ("update loads set x_mm = 1 where rowid = 1", "loads (phase 0, load_index 0) was changed", True),
    "a phase": ("delete from phases where phase = 1", "refers to a row of phases that is missing", True),
}


@pytest.mark.parametrize(("statement", "said", "in_quick"), EDITS.values(), ids=EDITS)
def test_a_check_names_what_is_not_as_it_was_stored(database, statement, said, in_quick):
    edit(database, f"pragma foreign_keys = off; {statement}")
    done = check_database(str(database), None, quiet, quick=False)
    assert done.exit_code == 1
    assert any(said in problem.what for problem in done.result.problems), done.result.problems
    assert done.result.runs == 2
    assert check_database(str(database), None, quiet, quick=True).exit_code == in_quick


def test_a_check_advises_what_is_possible_where_the_database_is(database_url):
    with open_store(database_url) as store:
        journalled(store, short_run(store.new_id()))
    engine = open_engine(parse_url(database_url))
    with writing(engine) as connection:
        connection.exec_driver_sql("UPDATE loads SET x_mm = 1.5")
    engine.dispose()
    done = check_database(database_url, None, quiet, quick=True)
    advice = dict(done.page.identity)["What to do"]
    of_file = database_url.startswith("sqlite")
    assert ("cbsr-qa db restore" in advice, "pg_restore" in advice) == (of_file, not of_file)


def test_a_sound_database_is_said_to_be(database):
    done = check_database(str(database), None, quiet, quick=False)
    assert (done.exit_code, done.result.runs, done.result.unchained, done.result.problems) == (0, 2, 0, ())
    assert done.page.banner.reason == "every row, frame and sample of 2 runs was checked"
    none = check_database(str(database), date(2100, 1, 1), quiet, quick=True)
    assert (none.exit_code, none.page.banner.headline) == (0, "no run was checked")
    edit(database, "delete from run_links; update runs set chain = null")
    assert check_database(str(database), None, quiet, quick=False).result.unchained == 2
