"""What the journal was told is what comes back, whatever happens in between."""

import hashlib
import json
import signal
import sqlite3
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from stored_runs import (
    CONFIGURATION,
    INDENTER,
    MATERIAL,
    SENSOR_TYPE,
    SETTING,
    SPENT,
    force,
    frames,
    identity,
    journalled,
    load,
    record,
    short_run,
)

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.steps import Press, Role, StrainStep
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock
from cbsr_qa.domain.readings.loads import EasedStrain
from cbsr_qa.domain.run.attendance import AskedPrompt, Pause, PromptShown, RunContinued, RunPaused
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


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a folder" / "runs.db"


@pytest.fixture
def repository(path):
    with open_store(f"sqlite:///{path}") as opened:
        yield opened


def same_frames(one, other):
    assert isinstance(one, FrameBlock)
    assert (one.unit, one.current_A) == (other.unit, other.current_A)
    np.testing.assert_array_equal(one.time_s, other.time_s)
    np.testing.assert_array_equal(one.voltages, other.voltages)
    np.testing.assert_array_equal(one.flags, other.flags)
    if other.reading_time_s is None:
        assert one.reading_time_s is None
    else:
        np.testing.assert_array_equal(one.reading_time_s, other.reading_time_s)


def test_a_run_comes_back_as_it_was_told(database_url):
    with open_store(database_url) as repository:
        run = repository.new_id()
        events = short_run(run)
        journalled(repository, events)
        back = repository.runs.load(run)
        assert repository.runs.read_configuration(run) == CONFIGURATION

    assert back.identity == identity(run)
    assert (back.sensor_type, back.material, back.indenter) == (SENSOR_TYPE, MATERIAL, INDENTER)
    assert (back.end, back.end_detail, back.station_s, back.spent) == (EndReason.FINISHED, "", 201.0, SPENT)

    first, second = back.phases
    assert (first.name, first.sequence, first.started_s, first.ended_s) == (
        "nine locations",
        "location-grid",
        0.5,
        155.0,
    )
    assert first.loads == (record(0, 30.0),)
    assert first.loads[0].clear_s == 91.25
    assert (first.role, second.role) == (Role.GRID, Role.OTHER)
    assert (first.unloaded_from_s, second.unloaded_from_s) == (3.0, None)
    told = [event.frames for event in events if isinstance(event, FramesTaken)]
    same_frames(first.frames.select(slice(0, 8)), told[0])
    same_frames(first.frames.select(slice(8, 9)), told[1])
    same_frames(second.frames, told[2])
    sampled = [event.samples for event in events if isinstance(event, SamplesTaken)]
    (channel,) = first.samples
    assert (channel.channel, channel.unit) == ("force", "N")
    np.testing.assert_array_equal(channel.values, np.concatenate([block.values for block in sampled]))
    assert second.samples == ()
    assert back.pauses == (Pause(0, 152.5, 153.5, "Zoë", "Ada"),)
    assert back.prompts == (AskedPrompt(0, 0, "Turn the sheet over", "sheet.png", 154.0, 154.5, "done", "Ada"),)


def test_a_run_cut_off_in_a_pause_has_a_pause_without_an_end_and_later_prompts_count_on(repository):
    run = repository.new_id()
    events = short_run(run)
    cut = next(number for number, event in enumerate(events) if isinstance(event, RunPaused))
    journalled(repository, events[: cut + 1])
    assert repository.runs.list_finished_loads(run) == ((0, 0),)
    assert repository.runs.count_prompts(run) == 0
    shown = PromptShown(0, 0, "Is the head clean?", "", 1.0)
    journalled(repository, [RunStarted(identity(run)), RunPaused(0, 0.5, "Ada"), RunContinued(0, 1.0, "Ada"), shown])
    back = repository.runs.load(run)
    assert back.pauses == (Pause(0, 152.5, None, "Zoë"), Pause(0, 153.0, 153.5, "Ada", "Ada"))
    assert back.prompts == (AskedPrompt(0, 0, "Is the head clean?", "", 153.5),)
    assert repository.runs.count_prompts(run) == 1


def test_every_document_is_committed_before_the_call_returns(repository, path):
    journal = repository.open_journal(configuration=CONFIGURATION, **SETTING)
    seen = []
    for event in short_run(repository.new_id()):
        journal(event)
        with sqlite3.connect(path) as other:  # another program, with a connection of its own
            tables = "run_states", "phases", "steps", "frame_blocks", "sample_blocks", "loads", "unloaded_marks"
            tables = (*tables, "attendance", "decisions")
            seen.append(tuple(other.execute(f"select count(*) from {table}").fetchone()[0] for table in tables))
    # Each document but the ends of phases adds exactly one row somewhere.
    gained = [sum(after) - sum(before) for before, after in pairwise(seen)]
    assert gained.count(0) == 2
    assert set(gained) == {0, 1}


@pytest.mark.rest
def test_a_killed_process_loses_nothing_that_was_committed(path):
    code = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parents[1] / "samples")!r})
from stored_runs import *
from cbsr_qa.store.opening import open_store
repository = open_store("sqlite:///{path}")
journal = journalled(repository, short_run("run-1")[:5])
for number in range(10_000):
    journal(FramesTaken(0, frames(4.0 + number, seed=number)))
    print(number, flush=True)
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        told = -1
        for line in process.stdout:
            told = int(line)
            if told >= 20:
                process.send_signal(signal.SIGKILL)
                break
    with open_store(f"sqlite:///{path}", create=False) as repository:
        back = repository.runs.load("run-1")
        assert back.end is EndReason.RUNNING
        kept = back.phases[0].frames
        assert len(kept) >= told + 1
        same_frames(kept.select(slice(told, told + 1)), frames(4.0 + told, seed=told))
        (incomplete,) = repository.unfinished.list_incomplete()
        assert (incomplete.run, incomplete.phase) == ("run-1", "nine locations")


def cut_off(run):
    """A run whose second press was not held to its end."""
    told = short_run(run)[:11]
    return [*told, StepStarted(0, 2, Press(load("L1")), 160.0, 100.0), FramesTaken(0, frames(162.0, seed=7))]


def test_a_resumed_run_goes_on_in_time_and_its_first_session_stays(repository):
    run = repository.new_id()
    journalled(repository, cut_off(run))
    before = repository.runs.load(run)
    assert before.phases[0].ended_s == 162.0  # the last thing known about it
    again = [
        RunStarted(identity(run)),
        PhaseStarted(0, "nine locations", "location-grid", 0.0),
        Unloaded(0, 1.0),
        FramesTaken(0, frames(5.0, seed=8)),
        SamplesTaken(0, force(5.0)),
        LoadFinished(0, record(1, 10.0)),
        LoadFinished(0, replace(record(2, 10.0), clear_s=None)),
        PhaseFinished(0, 140.0),
        RunEnded(EndReason.FINISHED, "", 141.0, SPENT),
    ]
    # Frames with and without times of their own are not joined: keep the sessions alike.
    again[3] = FramesTaken(0, frames(5.0, seed=8, own_times=True))
    journalled(repository, again)
    after = repository.runs.load(run)
    (phase,) = after.phases
    count = len(before.phases[0].frames)
    same_frames(phase.frames.select(slice(0, count)), before.phases[0].frames)
    assert (phase.started_s, phase.unloaded_from_s, phase.ended_s) == (0.5, 163.0, 302.0)
    assert phase.frames.time_s[-1] == 167.0
    assert [one.press_start_s for one in phase.loads] == [30.0, 172.0, 172.0]
    assert [one.clear_s for one in phase.loads] == [91.25, 233.25, None]
    assert np.all(np.diff(phase.samples[0].time_s) > 0)
    assert after.end is EndReason.FINISHED
    assert after.station_s == 303.0
    assert repository.unfinished.list_incomplete() == ()


def looped(index, start_s):
    """A press that was brought from 20 to 30 % and back down to 10 %."""
    eased = ((0.3, 10.0, 11.0), (0.1, 20.0, 22.5))
    strains = tuple(EasedStrain(strain, start_s + from_s, start_s + at_s) for strain, from_s, at_s in eased)
    return replace(record(index, start_s), eased=strains)


def test_a_loop_comes_back_as_it_was_pressed_and_is_no_ordinary_press(repository):
    run = repository.new_id()
    told = short_run(run)
    journalled(repository, [*told[:11], LoadFinished(0, looped(1, 130.0)), *told[11:]])
    phase = repository.runs.load(run).phases[0]
    assert phase.loads == (record(0, 30.0),)
    assert phase.loops == (looped(1, 130.0),)
    held = [(one.strain, one.start_s, one.end_s) for one in phase.loops[0].held]
    assert held == [(0.2, 131.0, 140.0), (0.3, 141.0, 150.0), (0.1, 152.5, 191.0)]


def test_a_loop_that_was_cut_off_is_pressed_again_as_a_whole_and_stored_on_the_runs_clock(repository, path):
    run = repository.new_id()
    begun = [StepStarted(0, 2, Press(load("L1")), 160.0, 100.0), StepStarted(0, 4, StrainStep(0.3), 170.0, 90.0)]
    journalled(repository, [*short_run(run)[:11], *begun, FramesTaken(0, frames(172.0, seed=7, own_times=True))])
    (incomplete,) = repository.unfinished.list_incomplete()
    assert incomplete.next == "press L1 at (15, -15) mm to 20 %, trial 1"
    with sqlite3.connect(path) as other:
        steps = [json.loads(step) for (step,) in other.execute("SELECT step FROM steps")]
    assert {"step": "Ease", "strain": 0.3} in steps  # as in databases of before, whatever the class is called
    assert repository.runs.list_finished_loads(run) == ((0, 0),)
    again = [
        RunStarted(identity(run)),
        PhaseStarted(0, "nine locations", "location-grid", 0.0),
        LoadFinished(0, looped(1, 10.0)),
    ]
    journalled(repository, again)
    assert repository.runs.list_finished_loads(run) == ((0, 0), (0, 1))
    assert repository.runs.load(run).phases[0].loops == (looped(1, 182.0),)


def test_a_finished_run_is_neither_resumed_nor_ended_again(repository):
    run = repository.new_id()
    journal = journalled(repository, short_run(run))
    with pytest.raises(StoreError, match="has ended already"):
        journal(RunEnded(EndReason.ABORTED, "", 300.0, ()))
    with pytest.raises(StoreError, match="is finished"):
        journalled(repository, [RunStarted(identity(run))])
    assert repository.runs.load(run).end is EndReason.FINISHED


@pytest.mark.rest
def test_an_aborted_run_can_be_resumed_and_its_time_is_summed(repository):
    run = repository.new_id()
    told = short_run(run)
    journalled(repository, [*told[:11], RunEnded(EndReason.ABORTED, "by the operator", 155.0, SPENT)])
    assert repository.runs.load(run).end_detail == "by the operator"
    journalled(repository, [RunStarted(identity(run)), RunEnded(EndReason.FINISHED, "", 5.0, (("hold", 2.0),))])
    back = repository.runs.load(run)
    assert (back.end, back.station_s) == (EndReason.FINISHED, 160.0)
    assert dict(back.spent) == {"press": 1.5, "hold": 62.0}


def test_a_run_is_not_resumed_with_another_configuration(repository):
    run = repository.new_id()
    journalled(repository, short_run(run)[:3])
    other = repository.open_journal(configuration="{}", **SETTING)
    changed = replace(identity(run), configuration_digest=hashlib.sha256(b"{}").hexdigest())
    with pytest.raises(StoreError, match="another configuration"):
        other(RunStarted(changed))


def test_a_digest_that_is_not_the_configurations_is_refused(repository):
    journal = repository.open_journal(configuration="{}", **SETTING)
    with pytest.raises(StoreError, match="does not match"):
        journal(RunStarted(identity("run-1")))
    assert repository.count_rows()["runs"] == 0


def test_documents_before_the_start_are_refused(repository):
    journal = repository.open_journal(configuration=CONFIGURATION, **SETTING)
    with pytest.raises(StoreError, match="before the run was started"):
        journal(Unloaded(0, 1.0))


def test_a_sample_that_is_not_a_number_is_refused_and_the_journal_goes_on(repository):
    run = repository.new_id()
    journal = journalled(repository, short_run(run)[:3])
    with pytest.raises(StoreError, match="force is not a finite number"):
        journal(SamplesTaken(0, SampleBlock("force", "N", np.array([1.0]), np.array([np.nan]))))
    journal(SamplesTaken(0, force(1.0)))
    assert len(repository.runs.load(run).phases[0].samples[0]) == 20
