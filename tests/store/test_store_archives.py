"""Archived frames: read as before, never lost when the program is killed, never those of a run to be looked at."""

import os
import shutil
import signal
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from stored_runs import journalled, short_run
from tiers import rest_but_named

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.measurement import Verdict
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.events import RunEnded
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.runs import archiving

LATER = datetime(2100, 1, 1, tzinfo=UTC)
AFTER = -1
ARRAYS = ("time_s", "voltages", "flags", "reading_time_s")


def decided(store, outcome=Outcome.PASS, serial="S-1"):
    run = store.new_id()
    journalled(store, short_run(run, serial))
    made = RunResult(store.runs.load(run), None, (), Verdict(outcome, "as it is"), None, "not asked for", (), ())
    store.analyses.save(made)
    return run


def bits(store, run):
    """Every array of a run, and its chain."""
    record = store.runs.load(run)
    arrays = [getattr(phase.frames, name) for phase in record.phases for name in ARRAYS]
    return [None if array is None else array.tobytes() for array in arrays], record.chain, record.chain_head


def archived(store, run, folder):
    (one,) = [one for one in store.archives.find_archivable(LATER) if one.run == run]
    return store.archives.archive(one, folder, LATER)


@pytest.fixture
def store(database_url, tmp_path, monkeypatch):
    monkeypatch.setenv("CBSR_QA_ARCHIVE", str(tmp_path))  # of a server
    with open_store(database_url) as opened:
        yield opened


def test_archived_frames_are_read_as_before_and_come_back(store, tmp_path):
    run = decided(store)
    before, parts = bits(store, run), store.live.read_frames(run, 0, 4.0, 12.0).voltages.tobytes()
    tail = [block.voltages.tobytes() for _, block in store.live.read_tail(run).frames]
    done = archived(store, run, tmp_path / "kept")
    assert Path(done.file).stat().st_size == done.file_bytes
    assert (done.frames, done.database_bytes > 0) == (11, True)
    assert store.archives.find_archivable(LATER) == ()
    assert bits(store, run) == before
    assert store.live.read_frames(run, 0, 4.0, 12.0).voltages.tobytes() == parts
    assert [block.voltages.tobytes() for _, block in store.live.read_tail(run).frames] == tail
    assert store.count_rows()["frames"] == 11
    assert store.soundness.check_run(run, frames=True).chained

    back = store.archives.unarchive(run)
    assert (back.frames, back.database_bytes) == (11, done.database_bytes)
    Path(done.file).rename(tmp_path / "away.h5")  # the database no longer needs it
    assert bits(store, run) == before
    with pytest.raises(StoreError, match="are not archived"):
        store.archives.unarchive(run)


@pytest.mark.postgres
def test_archives_of_a_server_are_found_from_the_folder_that_each_computer_names(
    postgres_database, tmp_path, monkeypatch
):
    with open_store(postgres_database) as store:
        run = decided(store)
        before = bits(store, run)
        with pytest.raises(StoreError, match="a PostgreSQL database has no folder"):
            store.archives.choose_folder(tmp_path / "here")
        monkeypatch.setenv("CBSR_QA_ARCHIVE", str(tmp_path / "here"))
        with pytest.raises(StoreError, match=r"is not below .*, the folder of archives: only files in it are read"):
            store.archives.choose_folder(tmp_path / "elsewhere")
        assert Path(archived(store, run, store.archives.choose_folder(tmp_path / "here" / "2026")).file).exists()
        (tmp_path / "here").rename(tmp_path / "there")
        with pytest.raises(StoreError, match=rf"run {run}: .*here is not reached from this computer") as refused:
            store.runs.load(run)
        assert "set CBSR_QA_ARCHIVE" in refused.value.remedy
        monkeypatch.delenv("CBSR_QA_ARCHIVE")
        with pytest.raises(StoreError, match="which nothing names here"):
            store.archives.unarchive(run)
        monkeypatch.setenv("CBSR_QA_ARCHIVE", str(tmp_path / "there"))
        assert bits(store, run) == before


@pytest.fixture(scope="module")
def passed(tmp_path_factory):
    path = tmp_path_factory.mktemp("passed") / "runs.db"
    with open_store(f"sqlite:///{path}") as store:
        run = decided(store)
        return path, run, bits(store, run)


@pytest.fixture
def kept(passed, tmp_path):
    """A SQLite database with one passed run, and what the run holds."""
    path, run, before = passed
    (tmp_path / "line").mkdir()
    return Path(shutil.copy(path, tmp_path / "line")), run, before


def test_the_file_is_found_from_the_database_wherever_both_are_moved(kept, tmp_path):
    path, run, before = kept
    with open_store(f"sqlite:///{path}") as store:
        archived(store, run, store.archives.choose_folder(None))
        store.shrink()
    shutil.move(path.parent, tmp_path / "moved")
    with open_store(f"sqlite:///{tmp_path / 'moved' / 'runs.db'}") as store:
        assert bits(store, run) == before


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda file: file.unlink(), "cannot be read: No such file"),
        (lambda file: file.write_bytes(file.read_bytes()[:-1] + b"?"), "was changed"),
    ],
)
def test_an_archive_that_is_missing_or_altered_is_named_with_its_run(kept, spoil, said):
    path, run, _ = kept
    with open_store(f"sqlite:///{path}") as store:
        spoil(Path(archived(store, run, path.parent / "a").file))
        for read in (store.runs.load, store.runs.check_resumable, store.archives.unarchive):
            with pytest.raises(StoreError, match=said) as refused:
                read(run)
            assert run in refused.value.reason
        with pytest.raises(StoreError, match=run):
            store.soundness.check_run(run, frames=True)
        assert store.runs.read_identity(run).run == run


def test_frames_that_somebody_may_have_to_look_at_stay(kept, tmp_path):
    path, run, _ = kept
    with open_store(f"sqlite:///{path}") as store:
        store.changes.override_verdict(decided(store, serial="S-2"), Outcome.PASS, operator="Ada", why="as seen")
        decided(store, serial="S-3")
        decided(store, Outcome.FAIL, serial="S-3")  # the sensor's latest verdict
        decided(store, Outcome.FAIL, serial="S-4")
        journalled(store, short_run(store.new_id(), "S-5"))  # no verdict yet
        journalled(store, short_run(store.new_id(), "S-6")[:-1])  # cut off
        journalled(store, [*short_run(store.new_id(), "S-7")[:-1], RunEnded(EndReason.BROKEN, "", 201.0, ())])
        marginal = decided(store, Outcome.MARGINAL, serial="S-8")
        assert {one.run for one in store.archives.find_archivable(LATER)} == {run, marginal}
        began = store.runs.read_identity(run).started_at
        assert store.archives.find_archivable(began) == ()
        assert {one.run for one in store.archives.find_archivable(began + timedelta(seconds=1))} == {run, marginal}


def test_a_file_that_is_not_the_runs_is_left_and_nothing_moves(kept, tmp_path):
    path, run, before = kept
    (tmp_path / f"{run}.h5").write_bytes(b"something else")
    with open_store(f"sqlite:///{path}") as store:
        with pytest.raises(StoreError, match="cannot be read"):
            archived(store, run, tmp_path)
        assert bits(store, run) == before
    assert (tmp_path / f"{run}.h5").read_bytes() == b"something else"


def killed_at(module, name, call, work):
    """Fork, kill the child when it calls a function or has called it, and say whether it came to that."""
    child = os.fork()
    if not child:
        original, calls = getattr(module, name), []

        def kill(*args, **kwargs):
            calls.append(name)
            if len(calls) > call >= 0:
                os.kill(os.getpid(), signal.SIGKILL)
            returned = original(*args, **kwargs)
            if call == AFTER:
                os.kill(os.getpid(), signal.SIGKILL)
            return returned

        setattr(module, name, kill)
        try:
            work()
        finally:
            os._exit(1)
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status)


STEPS = {
    step: (archiving, step, 0)
    for step in ("check_run", "write_archive", "_verify", "place_of", "insert", "_empty", "update")
}
STEPS |= {"after _empty": (archiving, "_empty", AFTER), "fsync": (os, "fsync", 0), "second fsync": (os, "fsync", 1)}


@pytest.mark.parametrize(("module", "name", "call"), rest_but_named(STEPS, "_verify", "insert", "after _empty"))
def test_a_kill_at_any_step_of_archiving_loses_nothing(kept, module, name, call):
    path, run, before = kept

    def work():
        with open_store(f"sqlite:///{path}") as store:
            archived(store, run, path.parent / "a")

    assert killed_at(module, name, call, work)
    with open_store(f"sqlite:///{path}") as store:
        assert bits(store, run) == before
        if store.archives.find_archivable(LATER):
            archived(store, run, path.parent / "a")
        assert bits(store, run) == before


BACK = {"read": ("read_checked", 0), "first": ("update", 0), "third": ("update", 2), "delete": ("delete", 0)}


@pytest.mark.parametrize(("name", "call"), rest_but_named(BACK, "third"))
def test_a_kill_while_frames_come_back_loses_nothing(kept, name, call):
    path, run, before = kept
    with open_store(f"sqlite:///{path}") as store:
        archived(store, run, path.parent / "a")

    def work():
        with open_store(f"sqlite:///{path}") as store:
            store.archives.unarchive(run)

    assert killed_at(archiving, name, call, work)
    with open_store(f"sqlite:///{path}") as store:
        assert bits(store, run) == before
        store.archives.unarchive(run)
        assert bits(store, run) == before
