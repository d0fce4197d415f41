"""What a station is doing, and what its page says of it: from its run's channel, the store and living processes."""

from dataclasses import replace
from datetime import timedelta

import pytest
from stored_lots import store_run
from stored_runs import identity, journalled, short_run

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.run.run import RunEnded, RunStarted
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.opening import open_store
from cbsr_qa.web.pages import minutes_left, reason_words, step_words, verdict_kind
from cbsr_qa.web.state import Mode, Snapshot, control_of, mode_of

_HELLO = {"run": None, "serial": "S-1", "recipe": "nine"}


@pytest.fixture
def store(tmp_path):
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}", durable=False) as opened:
        yield opened


def _control(**state):
    return control_of(_HELLO, {"remaining_s": 600.0, "clock_speed": 1.0, **state}, down=False)


def _snapshot(look, mode=None, control=None):
    mode = mode or mode_of(control, look, held=control is not None, starting=False)
    return Snapshot("bench", mode, control, look, None, "", "", "", "", healthy=True)


def _ended(store, *ends):
    """Store a run of as many sessions, an hour after each other; returns its name."""
    run = store.new_id()
    for hour, end in enumerate(ends):
        who = identity(run)
        began = RunStarted(replace(who, started_at=who.started_at + timedelta(hours=hour)))
        measured = short_run(run)[1:-1] if not hour else []
        ended = [] if end is EndReason.RUNNING else [RunEnded(end, "by Ada", 201.0, ())]
        journalled(store, [began, *measured, *ended])
    return run


def test_a_page_that_was_there_before_the_run_had_a_name_sees_it_end(store):
    before = store.live.find_run(store_run(store, "S-0", ()))
    look = store.live.find_run(_ended(store, EndReason.FINISHED))
    assert mode_of(_control(run=None), before, held=True, starting=True) is Mode.RUNNING
    assert mode_of(_control(run=look.run), look, held=True, starting=True) is Mode.CONCLUDING


@pytest.mark.parametrize(
    ("end", "mode", "kind"),
    [
        (EndReason.RUNNING, Mode.INTERRUPTED, "interrupted"),
        (EndReason.ABORTED, Mode.DONE, "aborted"),
        (EndReason.BROKEN, Mode.DONE, "broken"),
        (EndReason.FINISHED, Mode.DONE, "none"),
    ],
)
def test_a_run_without_a_result_is_interrupted_only_if_it_has_no_end(store, end, mode, kind):
    found = _snapshot(store.live.find_run(_ended(store, end)))
    assert (found.mode, verdict_kind(found), found.resumable) == (mode, kind, True)


def test_an_override_is_what_counts_with_who_decided(store):
    run = store_run(store, "S-1", (Measurement("drift", 0.1, "%/min"),))
    store.changes.override_verdict(run, Outcome.PASS, operator="Jo", why="tried")
    store.changes.override_verdict(run, Outcome.FAIL, operator="Bob", why="scratched")
    found = _snapshot(store.live.find_run(run))
    assert (verdict_kind(found), reason_words(found)) == ("fail", "overridden by Bob: scratched")
    assert found.look.outcome is not Outcome.FAIL


def test_a_resumed_run_was_worked_on_when_it_was_resumed(store):
    look = store.live.find_run(_ended(store, EndReason.ABORTED, EndReason.BROKEN))
    assert look.worked_at - look.started_at == timedelta(hours=1)


def test_the_time_left_stands_while_a_run_waits_and_is_unknown_on_a_clock_that_does_not(store):
    assert minutes_left(_snapshot(None, Mode.RUNNING, _control())) == "10 min left"
    assert minutes_left(_snapshot(None, Mode.PAUSED, _control())) == ""
    assert minutes_left(_snapshot(None, Mode.ASKING, _control())) == ""
    assert "not known" in minutes_left(_snapshot(None, Mode.RUNNING, _control(clock_speed=None)))


def test_the_step_names_the_press_that_is_under_way_or_the_next_one():
    load = {"label": "L3", "x_mm": 0.0, "y_mm": 0.0, "number": 3, "of": 9}
    said = [
        step_words(_snapshot(None, control=_control(step="homing", **state)))
        for state in (
            {"load": load, "next": None},
            {"load": None, "next": {"number": 4, "of": 9}},
            {"load": None, "next": {"number": 4, "of": 9}, "paused": {"by": "Ada"}},
            {"load": None, "next": None},
        )
    ]
    assert said == ["Press 3 of 9 · homing", "Next: press 4 of 9 · homing", "Next: press 4 of 9", "homing"]


def test_a_process_whose_run_has_ended_is_not_starting(store):
    look = store.live.find_run(_ended(store, EndReason.ABORTED))
    assert mode_of(None, look, held=True, starting=True, begun=True) is Mode.CONCLUDING
    assert mode_of(None, look, held=False, starting=True, begun=False) is Mode.STARTING
