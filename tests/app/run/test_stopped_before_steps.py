"""A signal between the opening of the bench and the first step: the bench is made safe and closed."""

import os
import signal

import pytest
from killing import BRIEF, write_files

from cbsr_qa.app.run import run as starting
from cbsr_qa.app.run.preview import plan_run
from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.app.run.resume import resume_run
from cbsr_qa.app.run.run import run_sensor
from cbsr_qa.app.run.session import Session
from cbsr_qa.domain.errors import StoppedError
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.station import bench, execution, setup
from cbsr_qa.station.control.lock import station_holder
from cbsr_qa.store.opening import open_store

NUMBERS = [signal.SIGTERM, signal.SIGINT, signal.SIGHUP]


@pytest.fixture
def request_of_run(tmp_path, monkeypatch):
    write_files(tmp_path, recipe=BRIEF)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CBSR_QA_VAR", "var")
    return RunRequest("station.toml", "recipe.toml", "S-1")


@pytest.fixture
def told(monkeypatch):
    """What the instruments are told, in order: (instrument, method)."""
    opened, made, calls = setup._open_instrument, [], []

    def noted(spec, *rest):
        made.append(spec.role)
        return opened(spec, *rest)

    stop_all = bench.stop_all

    def noting(actions, **how):
        calls.extend((who.partition(" ")[0], action.__name__) for who, action in actions)
        return stop_all(actions, **how)

    monkeypatch.setattr(setup, "_open_instrument", noted)
    monkeypatch.setattr(bench, "stop_all", noting)
    return made, calls


def strike(monkeypatch, place, name, number):
    """Send a signal when something is called for the first time."""
    real, called = getattr(place, name), []

    def struck(*arguments, **named):
        if not called:
            called.append(name)
            os.kill(os.getpid(), number)
        return real(*arguments, **named)

    monkeypatch.setattr(place, name, struck)


PLACES = {
    "while it is opened": (setup, "_open_instrument"),
    "when it is open": (setup, "check_clock"),
    "before the plan is checked": (Session, "walk"),
    "before the run is stored": (starting, "_begin_run"),
    "when instruments were asked": (starting, "_identity"),
}


#: Each place, and each signal once.
FIRST = [(signal.SIGTERM, place) for place in PLACES]
FIRST += [(number, "before the run is stored") for number in NUMBERS]


@pytest.mark.parametrize(
    ("number", "place"),
    [
        pytest.param(number, place, marks=() if (number, place) in FIRST else pytest.mark.rest)
        for number in NUMBERS
        for place in PLACES
    ],
)
def test_the_bench_is_made_safe_and_closed(request_of_run, told, monkeypatch, place, number):
    where, name = PLACES[place]
    strike(monkeypatch, where, name, number)
    before = signal.getsignal(number)
    with pytest.raises(StoppedError, match=f"stopped by signal {number.name} outside of the steps"):
        run_sensor(request_of_run)
    made, calls = told
    assert made or name == "_open_instrument"
    for role in made:
        of_it = [what for who, what in calls if who == role]
        assert of_it.index("safe_state") < of_it.index("close"), role
    assert station_holder("simulated") is None
    assert signal.getsignal(number) is before


def test_a_dry_run_is_stopped_in_the_same_way(request_of_run, told, monkeypatch):
    strike(monkeypatch, Session, "walk", signal.SIGTERM)
    with pytest.raises(StoppedError, match="SIGTERM"):
        plan_run(request_of_run)
    made, calls = told
    assert sorted(who for who, what in calls if what == "close") == sorted(made)


def test_a_run_that_is_resumed_is_stopped_in_the_same_way(request_of_run, told, monkeypatch):
    with monkeypatch.context() as patch:
        strike(patch, execution.Performer, "finish_load", signal.SIGTERM)
        first = run_sensor(request_of_run)
    assert (first.end, first.end_detail.startswith("by signal SIGTERM, while")) == (EndReason.ABORTED, True)
    made, calls = told
    made.clear()
    calls.clear()
    strike(monkeypatch, Session, "instruments", signal.SIGTERM)
    with pytest.raises(StoppedError, match="SIGTERM"):
        resume_run(first.run)
    assert sorted(who for who, what in calls if what == "close") == sorted(made)
    with open_store("sqlite:///var/cbsr-qa.db") as store:
        assert store.runs.read_last_session(first.run).end is EndReason.ABORTED


def test_signals_during_the_steps_are_those_of_the_run(request_of_run, monkeypatch):
    strike(monkeypatch, execution.Performer, "finish_load", signal.SIGINT)
    outcome = run_sensor(request_of_run)
    assert outcome.end_detail.startswith("by the operator (Ctrl-C), ")
