"""Twelve hours of station time with a random fault each hour: the run finishes, and memory does not grow."""

import os
import random
from dataclasses import dataclass
from pathlib import Path

import pytest
from killing import write_files

from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.app.run.resume import resume_run
from cbsr_qa.app.run.run import run_sensor
from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.runs.journal import Journal
from cbsr_qa_plugins.hardware.simulated_bench import SimulatedBench

HOURS = 12.0
SEED = int(os.environ.get("CBSR_QA_SOAK_SEED", "0"))
_PAGE = os.sysconf("SC_PAGE_SIZE")

#: Presses round nine places for half a day, with frames all the while, as a campaign does.
RECIPE = """
[recipe]
name = "half a day"
calibrate_phases = ["places"]

[[phases]]
name = "places"
sequence = "location-grid"
strains_percent = [20.0]
trials = 38
hold_s = 60.0
rest_s = 60.0
initial_rest_s = 240.0
"""


def resident_bytes():
    """Memory of this process that is in use."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE


@dataclass
class Faults:
    """Something goes wrong about once an hour of the station's time: a reply is lost, an instrument falls silent, the
    journal cannot store, the operator stops the run."""

    source: random.Random
    next_s: float = 0.0
    passed_s: float = 0.0
    struck: tuple = ()
    kinds: tuple = ()

    def due(self, now_s):
        """Whether one is due at a time of this session; then the next is drawn."""
        if self.passed_s + now_s < self.next_s:
            return False
        self.next_s = self.passed_s + now_s + self.source.expovariate(1 / 3600)
        return True

    def strike(self, kind):
        """Do it."""
        self.struck = (*self.struck, kind)
        match kind:
            case "lost reply":
                raise InstrumentError("bench", "simulated", "no answer within 1 s", retryable=True)
            case "silent":
                raise InstrumentError("bench", "simulated", "does not answer any more")
            case "operator":
                raise KeyboardInterrupt


@pytest.fixture
def faults(monkeypatch):
    """Faults in the bench and the journal; none until there are kinds of them."""
    found = Faults(random.Random(f"twelve hours {SEED}"))
    found.next_s = found.source.expovariate(1 / 3600)
    acquire, store = SimulatedBench.acquire, Journal.__call__

    def failing(self, count):
        if found.kinds and found.due(self._context.clock.now()):
            kind = found.source.choice(found.kinds)
            if kind == "journal":
                found.struck = (*found.struck, kind)
                refused.append(True)
            else:
                found.strike(kind)
        return acquire(self, count)

    refused = []

    def storing(self, event):
        if refused:
            refused.clear()
            raise OSError(28, "No space left on device")
        store(self, event)

    monkeypatch.setattr(SimulatedBench, "acquire", failing)
    monkeypatch.setattr(Journal, "__call__", storing)
    return found


@pytest.fixture
def request_of_half_a_day(tmp_path, monkeypatch):
    """Files of a run of more than twelve hours in a folder of its own."""
    write_files(tmp_path, memory=True)
    recipe = (tmp_path / "recipe.toml").read_text()
    (tmp_path / "recipe.toml").write_text(RECIPE + recipe[recipe.index("[reconstruction]") :])
    station = (tmp_path / "station.toml").read_text()
    (tmp_path / "station.toml").write_text(station.replace("duration_h = 12.0", "duration_h = 24.0"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CBSR_QA_VAR", "var")
    return RunRequest("station.toml", "recipe.toml", "S-1", seed=3)


def assert_all_of_it(record, faults):
    """Every press was made, over more than twelve hours, and faults struck."""
    assert record.end is EndReason.FINISHED
    assert record.station_s > HOURS * 3600
    assert len(record.phases[0].loads) == 9 * 38
    assert len(faults.struck) >= 4


def test_a_run_with_a_fault_an_hour_is_resumed_and_finishes(request_of_half_a_day, faults):
    faults.kinds = ("lost reply", "silent", "operator", "journal")
    outcome, sessions = run_sensor(request_of_half_a_day), 1
    while outcome.result.record.end is not EndReason.FINISHED:
        faults.passed_s = outcome.result.record.station_s
        outcome, sessions = resume_run(outcome.run), sessions + 1
        assert sessions < 60
    record = outcome.result.record
    assert_all_of_it(record, faults)
    assert len(record.sessions) == sessions > 1
    ended = [str(session.end) for session in record.sessions[:-1]]
    assert set(ended) <= {"aborted", "broken"}


def test_the_memory_of_a_session_of_twelve_hours_is_flat(request_of_half_a_day, faults, monkeypatch):
    """After the first hour it grows by 5 % at most, with a reply lost about each hour."""
    faults.kinds = ("lost reply",)
    seen = []
    stored = Journal.__call__

    def weighed(self, event):
        stored(self, event)
        if type(event).__name__ == "LoadFinished":
            seen.append((event.record.rest_end_s, resident_bytes()))

    monkeypatch.setattr(Journal, "__call__", weighed)
    outcome = run_sensor(request_of_half_a_day)
    assert_all_of_it(outcome.result.record, faults)
    assert len(outcome.result.record.sessions) == 1
    first = max(size for at_s, size in seen if at_s < 3600)
    last = max(size for at_s, size in seen if at_s > (HOURS - 1) * 3600)
    assert last / first <= 1.05, f"{first / 2**20:.1f} MiB after the first hour, {last / 2**20:.1f} after the last"
