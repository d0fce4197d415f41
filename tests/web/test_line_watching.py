"""The watching thread goes on whatever it meets, and says what that was."""

import sqlite3
from dataclasses import replace

import pytest
from served_line import until
from stored_lots import store_run

from cbsr_qa.config.loader import load_station
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.plan.plan import SyncSettings
from cbsr_qa.domain.results.measurement import Verdict
from cbsr_qa.store.opening import open_store
from cbsr_qa.web import watching
from cbsr_qa.web.channel import ChannelClient
from cbsr_qa.web.line import Line
from cbsr_qa.web.outcomes import cue
from cbsr_qa.web.pages import Pages
from cbsr_qa.web.stations import ServedStation
from cbsr_qa.web.watching import StationWatch, Watcher

STATION = replace(load_station("simulated").value, sync=SyncSettings("sqlite:///centre.db", 24.0))


@pytest.fixture
def url(tmp_path, monkeypatch):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path))
    return f"sqlite:///{tmp_path / 'runs.db'}"


@pytest.fixture
def watched(url):
    """Starts to watch stations of these names."""
    watchers = []

    def start(*names):
        stations = tuple(
            StationWatch(ServedStation(name, name, STATION, ()), ChannelClient(name, lambda: None)) for name in names
        )
        watchers.append(watcher := Watcher(stations, url, lambda names: None))
        watcher.start()
        return watcher, stations

    yield start
    for watcher in watchers:
        watcher.stop()
        assert not watcher.is_alive()


def test_a_damaged_run_of_one_station_hides_no_other_station(url, tmp_path, watched):
    with open_store(url) as store:
        damaged = store_run(store, "S-1", (), station="first")
        store_run(store, "S-2", (), station="second")
    with sqlite3.connect(tmp_path / "runs.db") as database:
        database.execute("update run_states set end = 'melted' where run = ?", (damaged,))
    watcher, (first, second) = watched("first", "second")
    until(lambda: second.snapshot, "the second station")
    assert (second.snapshot.serial, second.snapshot.trouble) == ("S-2", "")
    assert "run_states (number 0) was changed" in first.snapshot.look.altered
    assert watcher.trouble == ""


def test_what_nobody_has_foreseen_is_said_and_tried_again(watched, monkeypatch):
    failures = [ZeroDivisionError("nobody knew")]

    def sometimes(*arguments, **options):
        if failures:
            raise failures.pop()
        return open_store(*arguments, **options)

    monkeypatch.setattr(watching, "open_store", sometimes)
    watcher, (only,) = watched("only")
    until(lambda: "nobody knew" in watcher.trouble, "the trouble")
    watcher.wake()
    until(lambda: only.snapshot and not watcher.trouble, "the station")


def test_a_start_that_was_refused_is_shown_after_the_page_was_restarted_until_a_run_begins(url, tmp_path, watched):
    logs = tmp_path / "control" / "logs" / "only"
    logs.mkdir(parents=True)
    (logs / "20200101T100000000000.log").write_text("cbsr-qa: of before\n")
    refusal = (
        "cbsr-qa: the gate refuses\n  retest: S-1 passed\nretest: take the next\nat the command line: --override R\n"
    )
    (logs / "20240101T100000000000.log").write_text(f"opening the bench …\n{refusal}")
    _, (only,) = watched("only")
    until(lambda: only.snapshot, "the station")
    assert only.snapshot.refused.splitlines() == [
        "It was started on 2024-01-01 10:00 UTC.",
        "the gate refuses",
        "  retest: S-1 passed",
        "retest: take the next",
    ]
    with open_store(url) as store:
        store_run(store, "S-2", (), station="only")
    until(lambda: only.snapshot.serial == "S-2", "the run")
    assert not only.snapshot.refused


@pytest.mark.parametrize("outcome", [Outcome.PASS, Outcome.FAIL])
def test_the_failure_before_a_failure_is_kept(url, watched, outcome):
    with open_store(url) as store:
        first, _ = (
            store_run(store, "S-1", (), station="only", verdict=Verdict(each, "why"))
            for each in (outcome, Outcome.FAIL)
        )
        store_run(store, "S-2", (), station="other", verdict=Verdict(Outcome.FAIL, "why"))
    _, (only,) = watched("only")
    before = until(lambda: only.snapshot, "the station").failed_before
    assert (before and before.run) == (first if outcome is Outcome.FAIL else None)


@pytest.mark.parametrize("lifted", [False, True])
def test_a_pass_keeps_the_failure_with_another_recipe(url, watched, lifted):
    passed = Verdict(Outcome.PASS, "why")
    with open_store(url) as store:
        failed = store_run(store, "S-1", (), station="other", recipe="strict", verdict=Verdict(Outcome.FAIL, "why"))
        if lifted:
            store_run(store, "S-1", (), station="other", recipe="strict", verdict=passed)
        run = store_run(store, "S-1", (), station="only", recipe="usual", verdict=passed)
    _, (only,) = watched("only")
    snapshot = until(lambda: only.snapshot, "the station")
    standing = snapshot.standing_failure
    assert (snapshot.look.run, standing and standing.run) == (run, None if lifted else failed)
    shown = Pages(Line((), url)).fragment("verdict", s=snapshot, base="", asks_operator=False)
    assert ("This sensor failed with strict at other, just now: a pass with usual does not change" in shown) != lifted
    assert ("Put the sensor with those that failed." in shown) != lifted
    names = {"s": snapshot, "name": "only", "is_simulated": False}
    for part in ("state", "card"):
        html = Pages(Line((), url)).fragment(part, **names)
        assert ("Still failed" in html, "Passed" in html, "sign-warn" in html) == (not lifted, lifted, not lifted)
    assert cue(snapshot).partition(" ")[0] == ("pass" if lifted else "attention")


def test_a_backlog_that_is_too_old_is_no_good_health(url, tmp_path, watched):
    with open_store(url) as store:
        store_run(store, "S-1", (), station="only")
    with sqlite3.connect(tmp_path / "runs.db") as database:
        database.execute("update outbox set noted_at = '2026-01-01 00:00:00'")
    _, (only,) = watched("only")
    until(lambda: only.snapshot and only.snapshot.health, "the station")
    assert not only.snapshot.healthy
    assert "tell a test engineer; not sent to the central database: 1 item waits" in only.snapshot.health
