"""A database that fails in the middle of a run: the bench is safe, what was committed stays, and the run goes on."""

import pickle
import shutil
import sqlite3
import threading
from contextlib import closing

import numpy as np
import pytest
from killing import frames_of_loads, write_files
from made_once import made_once

from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.app.run.resume import resume_run
from cbsr_qa.app.run.run import run_sensor
from cbsr_qa.domain.errors import BrokenRunError, StoreError
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store import engine as engines
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.runs.journal import Journal
from cbsr_qa_plugins.hardware.simulated_bench import SimulatedBench

pytestmark = pytest.mark.rest


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with the files of a quick run, and the bench's heads watched."""
    write_files(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CBSR_QA_VAR", "var")
    return tmp_path


@pytest.fixture
def benches(monkeypatch):
    """Every simulated bench that was closed, with whether its head was told to come up before."""
    closed, told = [], set()
    safe_state, close = SimulatedBench.safe_state, SimulatedBench.close

    def watched(self):
        told.add(id(self))
        safe_state(self)

    def closing_it(self):
        closed.append(id(self) in told and self.world.presses[-1].steps[-1].change < 0)
        close(self)

    monkeypatch.setattr(SimulatedBench, "safe_state", watched)
    monkeypatch.setattr(SimulatedBench, "close", closing_it)
    return closed


def at_document(monkeypatch, number, happen):
    """Do something before the journal stores its n-th document."""
    stored, count = Journal.__call__, 0

    def counted(self, event):
        nonlocal count
        count += 1
        if count == number:
            happen()
        stored(self, event)

    monkeypatch.setattr(Journal, "__call__", counted)


def request(**more):
    return RunRequest("station.toml", "recipe.toml", "S-1", seed=5, **more)


def broken_run(**more):
    """Run until the database fails; return the run and what is said of it.

    There may be room, or a server again, for how it ended: it is then an outcome like others.
    """
    try:
        outcome = run_sensor(request(**more))
    except BrokenRunError as broken:
        run, said, code = broken.run, str(broken), broken.exit_code
    else:
        assert outcome.result.record.end is EndReason.BROKEN
        run, said, code = outcome.run, f"{outcome.result.record.end_detail}; {outcome.resume}", outcome.exit_code
    assert code == 3
    assert f"cbsr-qa run --resume {run}" in said
    assert "NOT SAFE" not in said
    return run, said


@pytest.fixture(scope="session")
def undisturbed():
    """A folder with a run that had nothing in its way, and its result."""

    def make(folder):
        write_files(folder)
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            patch.setenv("CBSR_QA_VAR", "var")
            (folder / "result.pickle").write_bytes(pickle.dumps(run_sensor(request()).result))

    return made_once("undisturbed", make)


@pytest.fixture(scope="session")
def whole(undisturbed):
    """Frames and samples of every load of a run with nothing in its way."""
    return pickle.loads((undisturbed / "result.pickle").read_bytes())


def assert_goes_on(run, whole, *, database=None):
    """Resume a run; what was committed stays, and the result is the one of a run with nothing in its way."""
    resumed = resume_run(run, database=database).result
    assert resumed.record.end is EndReason.FINISHED
    pairs = zip(frames_of_loads(whole.record), frames_of_loads(resumed.record), strict=True)
    for (_, arrays), (_, others) in pairs:
        for array, again in zip(arrays, others, strict=True):
            np.testing.assert_array_equal(array, again)
    assert [m.value for m in resumed.measurements] == [m.value for m in whole.measurements]
    assert resumed.verdict == whole.verdict
    return resumed


def stored_frames(path, run):
    with closing(sqlite3.connect(path)) as database:
        rows = database.execute("select phase, block, sha256 from frame_blocks where run = ?", (run,)).fetchall()
    return set(rows)


@pytest.mark.parametrize(("pages", "ends"), [(150, ("running", "broken")), (285, ("finished",))])
def test_a_full_disk(here, benches, whole, monkeypatch, pages, ends):
    """In the middle of the run, and when its result is stored."""
    set_up, path = engines._set_up_sqlite, here / "var" / "cbsr-qa.db"

    def small(connection, record, *, synchronous):
        set_up(connection, record, synchronous=synchronous)
        connection.execute(f"pragma max_page_count = {pages}")

    with monkeypatch.context() as patch:
        patch.setattr(engines, "_set_up_sqlite", small)
        run, said = broken_run()
    assert "var/cbsr-qa.db cannot grow: the disk is full" in said
    assert "free space" in said
    assert benches == [True]
    kept = stored_frames(path, run)
    assert len(kept) > 20
    with open_store(f"sqlite:///{path}") as store:
        state = store.runs.read_last_session(run)
        # The end of the run is a small row, for which there may be room.
        assert str(state.end) in ends
        assert state.end is not EndReason.BROKEN or "rule 'journal': the journal could not store" in state.detail
        assert store.claims.name_writer(run) == ""
    assert_goes_on(run, whole)
    assert kept <= stored_frames(path, run)


def zeroed(log, size):
    log.seek(size // 3)
    log.write(bytes(size // 3))


def scribbled(log, size):
    random = np.random.default_rng(7)
    for page in range(size // _LOGGED):
        log.seek(_HEADER + page * _LOGGED + _LOGGED - _PAGE)
        log.write(random.bytes(_PAGE) if random.random() < 0.3 else b"")


def cut(log, size):
    log.truncate(size // 2)


#: Of a log of SQLite: its header, a page, and a page with its own header [B].
_HEADER, _PAGE, _LOGGED = 32, 4096, 4120


@pytest.mark.parametrize("harm", [zeroed, scribbled, cut])
def test_a_log_that_is_damaged_in_the_middle_of_a_run_ends_in_no_verdict(here, benches, monkeypatch, harm):
    """The open connection goes on with the pages it remembers, so that nothing fails until they are looked for."""
    path = here / "var" / "cbsr-qa.db"

    def damage():
        log = path.with_name("cbsr-qa.db-wal")
        with log.open("r+b") as file:
            harm(file, log.stat().st_size)

    at_document(monkeypatch, 150, damage)
    with pytest.raises(BrokenRunError, match=r"cbsr-qa\.db is damaged .*, including this run") as broken:
        run_sensor(request())
    assert broken.value.reason.count("is damaged") == 1
    assert "if the database then holds the run, this continues it: cbsr-qa run --resume" in broken.value.remedy
    assert broken.value.exit_code == 3
    assert "restore the database from a copy; data measured after that copy is lost" in broken.value.remedy
    assert benches == [True]
    assert [one.name for one in (here / "var").rglob("S-1*")] == []  # no report, and no calibration


def test_damage_beside_a_run_is_told_from_damage_of_the_run(here, whole, undisturbed):
    """A page of another table is lost: this run is whole, and its file can be recovered."""
    run, path = whole.record.identity.run, here / "damaged.db"
    shutil.copy(undisturbed / "var" / "cbsr-qa.db", path)
    with closing(sqlite3.connect(path)) as database:
        database.execute("create table other (what)")
        database.execute("insert into other values (zeroblob(9000))")
        database.commit()
        (page,) = database.execute("select rootpage from sqlite_master where name = 'other'").fetchone()
    with path.open("r+b") as file:
        file.seek((page - 1) * _PAGE)
        file.write(b"\xff" * 64)
    with open_store(f"sqlite:///{path}") as store:
        with pytest.raises(StoreError, match="every row and frame of this run was checked and is intact") as refused:
            store.runs.load_with_file_check(run)
        assert f"sqlite3 {path} .recover" in refused.value.remedy
        assert store.runs.load(run).end is EndReason.FINISHED


def test_a_database_that_another_program_does_not_let_go(here, benches, whole, monkeypatch, capfd):
    monkeypatch.setattr(engines, "BUSY_TIMEOUT_MS", 1_000)
    monkeypatch.setattr(engines, "_PATIENCE_MS", 100)
    path = here / "var" / "cbsr-qa.db"
    other = []

    def lock():
        other.append(sqlite3.connect(path, isolation_level=None, check_same_thread=False))
        other[0].execute("begin immediate")

    with monkeypatch.context() as patch:
        at_document(patch, 120, lock)
        run, said = broken_run()
    assert "var/cbsr-qa.db is in use by another program; waiting" in capfd.readouterr().err
    assert "var/cbsr-qa.db is in use by another program (database is locked)" in said
    assert benches == [True]
    other[0].rollback()
    other[0].close()
    assert_goes_on(run, whole)


def test_a_database_that_is_let_go_in_time_stops_nothing(here, whole, monkeypatch, capfd):
    monkeypatch.setattr(engines, "_PATIENCE_MS", 100)
    path = here / "var" / "cbsr-qa.db"

    def lock_for_a_while():
        other = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
        other.execute("begin immediate")

        def let_go():
            other.rollback()
            other.close()

        threading.Timer(0.4, let_go).start()

    at_document(monkeypatch, 50, lock_for_a_while)
    result = run_sensor(request()).result
    assert "is in use by another program; waiting" in capfd.readouterr().err
    assert [m.value for m in result.measurements] == [m.value for m in whole.measurements]


@pytest.mark.postgres
def test_a_server_that_hangs_up(here, benches, whole, monkeypatch, postgres_server, postgres_database):
    name = postgres_database.rpartition("/")[2]

    def hang_up():
        postgres_server.execute(f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = '{name}'")

    with monkeypatch.context() as patch:
        at_document(patch, 120, hang_up)
        run, said = broken_run(database=postgres_database)
    assert name in said
    assert "closed the connection" in said
    assert benches == [True]
    assert_goes_on(run, whole, database=postgres_database)


@pytest.mark.postgres
def test_on_postgresql_one_process_writes_a_run_at_a_time(postgres_database):
    with open_store(postgres_database) as one, open_store(postgres_database) as other:
        with one.claims.hold_run("run-1", "Kim"):
            assert other.claims.name_writer("run-1").startswith("Kim on ")
            with pytest.raises(StoreError, match="is being written by Kim on"), other.claims.hold_run("run-1", "Jo"):
                pass
            with other.claims.hold_run("run-2", "Jo"):
                pass
        assert other.claims.name_writer("run-1") == ""
