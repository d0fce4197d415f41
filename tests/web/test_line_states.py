"""What a station is doing, and what its page says of it: from its run's channel, the store and living processes."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import pytest
from stored_lots import store_run
from stored_runs import identity, journalled, short_run

from cbsr_qa.analysis.run.live import PlacePreview
from cbsr_qa.app.run.control import confirm_bench
from cbsr_qa.config.loader import load_station
from cbsr_qa.domain.plan.limits import FailureCode, Limit, Outcome
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.domain.run.events import RunEnded, RunStarted
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.opening import open_store
from cbsr_qa.web.confirmations import name_confirmer, needs_confirmation
from cbsr_qa.web.line import Line
from cbsr_qa.web.live_run import Place
from cbsr_qa.web.outcomes import ago_words, cue, reason_words, verdict_kind
from cbsr_qa.web.pages import (
    Pages,
    describe_measured,
    minutes_left,
    place_kind,
    place_numbers,
    place_words,
    progress_words,
    size_of,
)
from cbsr_qa.web.state import FailedLimit, Mode, Snapshot, control_of, mode_of
from cbsr_qa.web.stations import OfferedRecipe, ServedStation

_PASSED = Verdict(Outcome.PASS, "it is well")
_HELLO = {"run": None, "serial": "S-1", "recipe": "nine"}


@pytest.fixture
def store(tmp_path):
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}", durable=False) as opened:
        yield opened


def _control(**state):
    return control_of(_HELLO, {"remaining_s": 600.0, "clock_speed": 1.0, **state}, down=False)


def _snapshot(look, mode=None, control=None, live=None):
    mode = mode or mode_of(control, look, held=control is not None, starting=False)
    return Snapshot("bench", mode, control, look, (), None, live, "", "", "", "", healthy=True)


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
    assert (found.mode, verdict_kind(found.look), found.resumable) == (mode, kind, True)


def test_an_override_is_what_counts_with_who_decided(store):
    run = store_run(store, "S-1", (Measurement("drift", 0.1, "%/min"),))
    store.changes.override_verdict(run, Outcome.PASS, operator="Jo", why="tried")
    store.changes.override_verdict(run, Outcome.FAIL, operator="Bob", why="scratched")
    found = _snapshot(store.live.find_run(run))
    assert (verdict_kind(found.look), reason_words(found.look)) == ("fail", "overridden by Bob: scratched")
    assert found.look.outcome is not Outcome.FAIL


def test_a_resumed_run_was_worked_on_when_it_was_resumed(store):
    look = store.live.find_run(_ended(store, EndReason.ABORTED, EndReason.BROKEN))
    assert look.worked_at - look.started_at == timedelta(hours=1)


def test_the_time_left_stands_while_a_run_waits_and_is_unknown_on_a_clock_that_does_not(store):
    assert minutes_left(_snapshot(None, Mode.RUNNING, _control())) == "10 min left"
    assert minutes_left(_snapshot(None, Mode.PAUSED, _control())) == ""
    assert minutes_left(_snapshot(None, Mode.ASKING, _control())) == ""
    assert "not known" in minutes_left(_snapshot(None, Mode.RUNNING, _control(clock_speed=None)))


def test_progress_is_one_counter_of_presses_under_way_or_next():
    load = {"label": "L3", "x_mm": 0.0, "y_mm": 0.0, "number": 3, "of": 23}
    said = [
        progress_words(_snapshot(None, control=_control(step="pressing L3 at (0, 0) mm", **state)))
        for state in (
            {"load": load, "next": None},
            {"load": None, "next": {"number": 4, "of": 23}},
            {"load": None, "next": None},
        )
    ]
    assert said == ["Press 3 of 23", "Press 4 of 23", ""]


@pytest.mark.parametrize(
    ("end", "detail", "kind", "reason"),
    [
        (EndReason.ABORTED, "by Ada (remote), while pressing L3 at (0, 0) mm", "aborted", "Stopped by Ada."),
        (EndReason.ABORTED, "by the operator (Ctrl-C) and at once by a second signal, while", "emergency", ""),
        (EndReason.ABORTED, "by an emergency stop by Bo (remote), while", "emergency", "Stopped by an emergency"),
        (EndReason.BROKEN, "instrument bench: no answer", "broken", "instrument bench: no answer"),
    ],
)
def test_after_an_emergency_stop_or_a_fault_somebody_confirms_the_bench_once_for_each(
    store, tmp_path, monkeypatch, end, detail, kind, reason
):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path))
    look = replace(store.live.find_run(_ended(store, end)), detail=detail)
    assert (verdict_kind(look), reason_words(look).startswith(reason)) == (kind, True)
    assert needs_confirmation(look) is (kind != "aborted")
    mode = mode_of(None, look, held=False, starting=False, unsafe=needs_confirmation(look))
    assert mode is (Mode.DONE if kind == "aborted" else Mode.UNSAFE)
    confirm_bench(look.run, look.session_at, look.station, "Ada")
    assert not needs_confirmation(look)
    assert name_confirmer(look) == "Ada"
    later = replace(look, session_at=look.session_at + timedelta(hours=1))
    assert needs_confirmation(later) is (kind != "aborted")


def test_each_state_that_needs_somebody_has_a_sound_of_its_own(store):
    passed = store.live.find_run(store_run(store, "S-1", (Measurement("drift", 0.1, "%/min"),), verdict=_PASSED))
    stopped = store.live.find_run(_ended(store, EndReason.ABORTED))
    asking = _control(prompt={"prompt": 1, "text": "?", "picture": ""})
    sounds = [
        cue(snapshot).partition(" ")[0]
        for snapshot in (
            None,
            _snapshot(passed, Mode.RUNNING, _control()),
            _snapshot(passed, Mode.ASKING, asking),
            _snapshot(passed, Mode.CONCLUDING),
            _snapshot(passed, Mode.DONE),
            _snapshot(stopped, Mode.DONE),
            _snapshot(stopped, Mode.INTERRUPTED),
        )
    ]
    assert sounds == ["", "", "attention", "end", "pass", "end", "end"]


@pytest.mark.parametrize(
    ("past", "words"),
    [
        (timedelta(seconds=20), "just now"),
        (timedelta(minutes=3, seconds=10), "3 min ago"),
        (timedelta(hours=5), "5 h ago"),
        (timedelta(days=400), "on 20"),
        (timedelta(hours=-1), "on 20"),
    ],
)
def test_how_long_ago_a_test_was(past, words):
    assert ago_words(datetime.now(UTC) - past).startswith(words)


def test_a_time_is_that_of_the_computers_clock(in_zurich):
    assert ago_words(datetime(2026, 1, 31, 23, 30, tzinfo=UTC)) == "on 2026-02-01 00:30 CET"
    assert ago_words(datetime(2026, 7, 31, 23, 30, tzinfo=UTC)) == "on 2026-08-01 01:30 CEST"


@pytest.mark.parametrize(("length", "size"), [(5, "short"), (20, "medium"), (64, "long")])
def test_a_long_serial_number_is_written_smaller(length, size):
    assert size_of("S" * length) == size


def test_a_process_whose_run_has_ended_is_not_starting(store):
    look = store.live.find_run(_ended(store, EndReason.ABORTED))
    assert mode_of(None, look, held=True, starting=True, begun=True) is Mode.CONCLUDING
    assert mode_of(None, look, held=False, starting=True, begun=False) is Mode.STARTING


def test_a_second_failure_says_so(store, tmp_path):
    run = store_run(store, "S-1", (), station="bench", verdict=Verdict(Outcome.FAIL, "it drifts"))
    look = store.live.find_run(run)
    pages = Pages(Line((), str(tmp_path / "runs.db")))
    shown = [
        pages.fragment(
            "verdict", s=replace(_snapshot(look, Mode.DONE), failed_before=before), base="", asks_operator=False
        )
        for before in (None, look)
    ]
    assert ["This sensor has failed before: at bench, just now." in html for html in shown] == [False, True]


def test_every_failed_limit_is_shown_with_its_code_and_what_to_do_if_it_has_them(store, tmp_path):
    run = store_run(store, "S-1", (Measurement("drift", 0.1, "%/min"),), verdict=Verdict(Outcome.FAIL, "it drifts"))
    code = FailureCode("F12", "it drifts", "scrap it")
    coded = (FailedLimit("drift is 2 %/min", code), FailedLimit("drift (L2) is 1 %/min", code))
    failed = (*coded, *(FailedLimit(f"overlap (L{place}) is low") for place in range(6)))
    snapshot = replace(_snapshot(store.live.find_run(run), Mode.DONE), failed=failed)
    shown = Pages(Line((), str(tmp_path / "runs.db"))).fragment("verdict", s=snapshot, base="", asks_operator=False)
    assert "Failed limits: 8" in shown
    assert shown.count("<b>F12</b> it drifts") == shown.count('<p class="todo">Scrap it.') == 1
    assert "Drift (L2) is 1 %/min" in shown
    assert [shown.count(f"Overlap (L{place}) is low") for place in range(6)] == [1] * 6
    assert "and 4 more" in shown


@pytest.mark.parametrize(("end", "is_shown"), [(EndReason.FINISHED, False), (EndReason.ABORTED, True)])
def test_after_a_start_that_came_to_nothing_no_other_sensors_verdict_is_shown(store, tmp_path, end, is_shown):
    """Only a run that can be resumed stays, and beside what says that the other did not start."""
    pages = Pages(Line((), str(tmp_path / "runs.db")))
    run = _ended(store, end) if end is EndReason.ABORTED else store_run(store, "S-1", (), verdict=_PASSED)
    look = store.live.find_run(run)
    names = {"name": "bench", "base": "", "asks_operator": False, "is_simulated": False}
    for serial, verdict in (("S-114", is_shown), (look.serial, True)):
        ended = replace(_snapshot(look, Mode.DONE), starting=serial, refused="Its start was cancelled by Ada.")
        state, card, shown = (pages.fragment(part, s=ended, **names) for part in ("state", "card", "verdict"))
        assert ("Did not start" in state, f">{serial}</p>" in state, "Passed" in state) == (True, True, False)
        assert ("Did not start" in card, "Passed" in card) == (True, False)
        assert ("What to do" in shown) is verdict
        assert f"The run of {serial} did not start" in pages.fragment("refused", s=ended)
    assert "Did not start" not in pages.fragment("state", s=replace(ended, refused=""), **names)


def test_a_start_that_somebody_cancelled_looks_neither_failed_nor_broken(store, tmp_path):
    look = store.live.find_run(store_run(store, "S-1", (), verdict=_PASSED))
    pages = Pages(Line((), str(tmp_path / "runs.db")))
    for cancelled in (True, False):
        s = replace(_snapshot(look, Mode.DONE), starting="S-2", refused="Nothing has moved.", cancelled=cancelled)
        state, card, why = (
            pages.fragment(part, s=s, name="bench", is_simulated=False) for part in ("state", "card", "refused")
        )
        assert ("board aborted" in state, "board refused" in state) == (cancelled, not cancelled)
        assert ("badge aborted" in card, "badge refused" in card) == (cancelled, not cancelled)
        assert ("trouble cancelled" in why) is cancelled
        assert ["sign-fail" in html or "sign-warn" in html for html in (state, card, why)] == 3 * [not cancelled]
        assert "Did not start" in state
        assert "Did not start" in card


def test_a_pressed_place_does_not_look_as_if_it_had_passed_or_failed():
    load = SimpleNamespace(label="L1", x_mm=0.0, y_mm=0.0)
    seen = [Place(load, PlacePreview(*found), now=False) for found in ((1.0, 70.0), (9.0, 2.0), (None, None))]
    assert {place_kind(place) for place in seen} == {"pressed"}
    assert [place_words(place) for place in seen] == ["pressed", "pressed", "pressed, not seen"]
    assert [place_numbers(place) for place in seen] == ["overlap 70 %, 1.0 mm off", "overlap 2 %, 9.0 mm off", ""]
    assert [place_kind(Place(load, None, now=now)) for now in (False, True)] == ["open", "running"]


@pytest.mark.parametrize("simulated", [True, False])
def test_station_card_and_verdict_say_whether_the_bench_is_simulated(store, tmp_path, simulated):
    look = store.live.find_run(store_run(store, "S-1", (), verdict=_PASSED))
    assert look.simulated
    station = load_station("simulated").value
    station = station if simulated else replace(station, clock="real")
    line = Line(
        (ServedStation("bench", "bench", station, (OfferedRecipe("nine", "nine"),)),), str(tmp_path / "runs.db")
    )
    pages, snapshot = Pages(line), _snapshot(replace(look, simulated=simulated), Mode.DONE)
    line.stations["bench"].snapshot = snapshot
    mark = '<span class="simulated">simulated</span>'
    assert (f"bench {mark}</h1>" in pages.station("bench", control=True)) is simulated
    assert (f"bench {mark}</h2>" in pages.overview(control=True)) is simulated
    assert (mark in pages.fragment("verdict", s=snapshot, base="", asks_operator=False)) is simulated


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (71.5, "71.5 %, 3.50 percentage points below the limit"),
        (93.0, "93.0 %, 3.00 percentage points above the limit"),
        (80.0, "80.0 %, 5.00 percentage points inside the limit"),
    ],
)
def test_a_value_is_said_with_its_distance_from_the_limit(value, words):
    judged = Measurement("area_overlap", value, "%").judge(Limit("area_overlap", "%", 75.0, 90.0))
    assert describe_measured(judged).replace("\N{NO-BREAK SPACE}", " ") == words
