"""Sessions of a run: who went on with it, what of each counts, and one writer at a time."""

import os
import signal
import sqlite3
import subprocess
import sys
import textwrap
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from stored_runs import CONFIGURATION, SETTING, force, frames, identity, journalled, load, record, short_run

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.steps import FindSurface, Home, Press
from cbsr_qa.domain.run.events import (
    FramesTaken,
    LoadFinished,
    PhaseFinished,
    PhaseStarted,
    RunEnded,
    RunStarted,
    SamplesTaken,
    StepStarted,
    Unloaded,
)
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.types import time_of_id


@pytest.fixture
def path(tmp_path):
    return tmp_path / "runs.db"


@pytest.fixture
def repository(path):
    with open_store(f"sqlite:///{path}") as opened:
        yield opened


def resumed(run, operator="Jo"):
    """The document that begins another session."""
    later = identity(run).started_at + timedelta(hours=3)
    return RunStarted(replace(identity(run), operator=operator, software=(("cbsr-qa", "0.2.0"),), started_at=later))


def pressed_again(run):
    """A run whose second press was cut off, and made again in a second session."""
    first = short_run(run)[:11]  # a set-up, a load from 30 to 151 s
    cut = [StepStarted(0, 9, Press(load("L1")), 160.0, 100.0), FramesTaken(0, frames(162.0, seed=7, own_times=True)),
           SamplesTaken(0, force(163.0))]  # fmt: skip
    again = [
        resumed(run),
        PhaseStarted(0, "nine locations", "location-grid", 0.0),
        StepStarted(0, 0, Home(), 0.5, 100.0),
        Unloaded(0, 1.0),
        FramesTaken(0, frames(5.0, seed=8, own_times=True)),
        LoadFinished(0, record(1, 10.0)),
        PhaseFinished(0, 140.0),
        RunEnded(EndReason.FINISHED, "", 141.0, ()),
    ]
    return first, cut, again


def test_every_session_says_who_began_it_and_how_it_ended(repository):
    run = repository.new_id()
    first, cut, again = pressed_again(run)
    journalled(repository, [*first, *cut])
    journalled(repository, again)
    one, other = repository.runs.load(run).sessions
    assert (one.started_s, one.ended_s, one.end, one.operator) == (0.0, None, EndReason.RUNNING, "Zoë Ōtani")
    assert (other.end, other.operator, other.software) == (EndReason.FINISHED, "Jo", (("cbsr-qa", "0.2.0"),))
    assert (other.ended_s - other.started_s, other.noted_at - one.noted_at) == (141.0, timedelta(hours=3))
    # The run itself stays what it was begun as.
    assert repository.runs.load(run).identity == identity(run)


def test_frames_of_a_press_that_was_made_again_are_kept_and_do_not_count(repository, path):
    run = repository.new_id()
    first, cut, again = pressed_again(run)
    journalled(repository, [*first, *cut])
    before = repository.runs.load(run)
    assert before.set_aside == 0
    journalled(repository, again)
    after = repository.runs.load(run)
    (phase,) = after.phases
    offset_s = after.sessions[1].started_s
    taken = [event.frames for event in first if isinstance(event, FramesTaken)]
    counted = np.concatenate([*(block.time_s for block in taken), [5.0 + offset_s]])
    np.testing.assert_array_equal(phase.frames.time_s, counted)
    assert after.set_aside == 1
    assert len(before.phases[0].frames) == len(counted)  # 9 and the one of the press that was cut off
    samples = phase.samples[0].time_s
    assert samples.max() <= 151.0
    assert before.phases[0].samples[0].time_s.max() > 163.0


def test_a_session_goes_on_after_the_last_sample_of_a_rest_without_frames(repository):
    run = repository.new_id()
    journalled(repository, [*short_run(run)[:4], SamplesTaken(0, force(77.3))])
    last_s = repository.runs.load(run).phases[0].samples[0].time_s[-1]
    assert repository.runs.find_resume_time_s(run) >= last_s > 77.3
    assert repository.runs.find_resume_time_s(run) * 2**20 % 1 == 0
    journalled(repository, [resumed(run), StepStarted(0, 0, Home(), 0.0, 1.0), SamplesTaken(0, force(0.0))])
    assert repository.runs.read_last_session(run).started_s == repository.runs.find_resume_time_s(run) - float(
        force(0.0).time_s[-1]
    )


def test_what_sets_the_bench_up_again_does_not_count_for_a_phase_that_had_ended(repository):
    run = repository.new_id()
    told = short_run(run)
    end = next(n for n, event in enumerate(told) if isinstance(event, PhaseFinished))
    journalled(repository, told[: end + 1])
    before = repository.runs.load(run).phases[0]
    set_up = [StepStarted(0, 1, FindSurface(0.0, 0.0), 0.0, 1.0), SamplesTaken(0, force(0.5))]
    journalled(repository, [resumed(run), *set_up])
    after = repository.runs.load(run).phases[0]
    assert len(after.samples[0]) == len(before.samples[0])
    assert repository.runs.list_ended_phases(run) == {0}


def test_next_is_the_press_after_one_that_was_made_again(repository):
    run = repository.new_id()
    first, cut, again = pressed_again(run)
    journalled(repository, [*first, *cut])
    assert repository.unfinished.list_incomplete()[0].next == "press L1 at (15, -15) mm to 20 %, trial 1"
    journalled(repository, [*again[:5], StepStarted(0, 9, Press(load("L1")), 9.0, 1.0)])
    assert repository.unfinished.list_incomplete()[0].next == "press L1 at (15, -15) mm to 20 %, trial 1"
    journalled(repository, [resumed(run), LoadFinished(0, record(1, 10.0)), StepStarted(0, 0, Home(), 200.0, 1.0)])
    assert repository.unfinished.list_incomplete()[0].next == "home"


# --- one writer ---


def holding(path, run, *, until="sys.stdin.read()"):
    """Another process that writes a run."""
    code = f"""
    import sys
    from cbsr_qa.store.opening import open_store
    with open_store("sqlite:///{path}") as repository, repository.claims.hold_run("{run}", "Kim"):
        print("held", flush=True)
        {until}
    """
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "held\n"
    return process


def test_a_run_that_another_process_writes_is_refused_and_says_who(repository, path):
    journalled(repository, short_run("run-1")[:8])
    with holding(path, "run-1") as process:
        with (
            pytest.raises(StoreError, match=f"run-1 is being written by Kim on .*, process {process.pid}"),
            repository.claims.hold_run("run-1"),
        ):
            pass
        assert repository.claims.name_writer("run-1").startswith("Kim on ")
        (incomplete,) = repository.unfinished.list_incomplete()
        assert incomplete.writer.startswith("Kim on ")
        with repository.claims.hold_run("run-2"):  # another run is free
            pass
        process.communicate("")
    with repository.claims.hold_run("run-1"):
        assert repository.claims.name_writer("run-1") != ""
    assert repository.claims.name_writer("run-1") == ""
    assert not list(path.parent.glob("*.lock"))


def test_a_killed_writer_holds_nothing(repository, path):
    with holding(path, "run-1") as process:
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert [left.name for left in path.parent.glob("*.lock")] == ["runs.db-run-1.lock"]
    assert repository.claims.name_writer("run-1") == ""
    with repository.claims.hold_run("run-1"):
        pass
    assert not list(path.parent.glob("*.lock"))


def full(*_):
    raise OSError(28, "No space left on device")


def test_on_a_full_disk_the_run_is_refused_and_the_disk_is_named(repository, path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with (
            pytest.raises(StoreError, match="No space left on device") as refused,
            repository.claims.hold_run("run-1"),
        ):
            pass
    assert "free space" in refused.value.remedy
    assert str(path) in refused.value.reason
    assert not list(path.parent.glob("*.lock"))


def test_the_lock_is_given_back_after_an_error(repository):
    with pytest.raises(RuntimeError), repository.claims.hold_run("run-1"):
        raise RuntimeError
    assert repository.claims.name_writer("run-1") == ""


# --- clocks that are set back ---


def test_runs_keep_their_order_where_the_clock_was_set_back(path):
    at = datetime(2026, 11, 22, 12, tzinfo=UTC)
    with open_store(f"sqlite:///{path}", wall=lambda: at) as repository:
        first = repository.new_id()
        journalled(repository, [RunStarted(replace(identity(first), started_at=at))])
    with open_store(f"sqlite:///{path}", wall=lambda: at - timedelta(days=40)) as repository:
        warned = repository.describe_clock_fault()
        second = repository.new_id()
        journalled(repository, [RunStarted(replace(identity(second), started_at=at - timedelta(days=40)))])
        assert second > first
        assert repository.runs.resolve("S-1") == second
        assert [run.run for run in repository.runs.find()] == [second, first]
        assert repository.new_id() > second
    assert "2026-11-22 12:00 UTC" in warned
    assert "2026-10-13 12:00" in warned
    assert time_of_id(second) >= at


def test_a_clock_that_is_right_is_not_warned_about(repository):
    assert repository.describe_clock_fault() == ""
    journalled(repository, [RunStarted(identity(repository.new_id()))])
    assert repository.describe_clock_fault() == ""


def test_the_journal_takes_nothing_from_the_wall_clock(repository):
    """Times of a run come from the station's clock; the wall clock is only noted."""
    run = repository.new_id()
    journal = repository.open_journal(configuration=CONFIGURATION, **SETTING)
    journal(RunStarted(replace(identity(run), started_at=datetime(1970, 1, 1, tzinfo=UTC))))
    journal(RunEnded(EndReason.ABORTED, "", 5.0, ()))
    assert repository.runs.read_last_session(run).ended_s == 5.0


def test_a_stop_at_once_is_of_the_latest_session_of_the_latest_run_and_damage_is_none(path, repository):
    def find():
        return repository.runs.find_emergency_stop("bench-α")

    assert find() is None
    run = repository.new_id()
    by_ada = RunEnded(EndReason.ABORTED, "by an emergency stop by Ada (remote), while homing", 201.0, ())
    journalled(repository, [*short_run(run)[:-1], by_ada])
    assert find() == (run, identity(run).started_at)
    assert repository.runs.find_emergency_stop("another") is None
    journalled(repository, [resumed(run)])
    assert find() is None
    journalled(repository, [resumed(run), by_ada])
    assert find() == (run, resumed(run).identity.started_at)
    for damaged in ("'melted'", "x'ff'"):
        with sqlite3.connect(path) as database:
            database.execute(f"UPDATE run_states SET end = {damaged} WHERE end = 'aborted'")
        database.close()
        assert find() is None
