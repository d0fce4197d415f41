"""What a plugin does for ever, takes all of, or sets under a run: a signal ends it, and nothing is lost."""

import os
import signal
import sqlite3
import sys
import time

import killing
import pytest
from command import cbsr_qa, document
from hostile import arguments_of, install, run_hostile, start, until, verdicts

pytestmark = pytest.mark.rest


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with the plugin installed beside us, and a short recipe that names its metric."""
    return install(tmp_path_factory.mktemp("hostile"))


_SECTION = "import: import time; from cbsr_qa_plugins.sections.limits import Limits; Limits.render = "
_METHOD = "from cbsr_qa_plugins.reconstruction.one_step import GaussNewtonNoser as Method"
_PRESS = "from cbsr_qa_plugins.hardware.simulated_bench import SimulatedBench as Bench"
#: What a plugin does for ever; after which words on stderr the run is sent SIGTERM; and what it then says.
_ENDLESS = {
    "a metric that sleeps": ("metric: import time; time.sleep(1e6)", "metrics", "stopped by signal SIGTERM while"),
    "a metric that cannot be stopped": (
        "import: import time, hostile_plugin; from cbsr_qa.app.run import conclusion\n"
        "conclusion._STOPS_WITHIN_S = 1.0\n"
        "def measure_run(self, run):\n  while True:\n    try: time.sleep(0.1)\n    except BaseException: pass\n"
        "measure_run.__globals__['time'] = time; hostile_plugin.Metric.measure_run = measure_run",
        "metrics",
        "a plugin does not stop: this process ends at once",
    ),
    "a section that sleeps": (
        f"{_SECTION} lambda self, result: time.sleep(1e6)",
        "rendering the report",
        "stopped by signal SIGTERM while",
    ),
    "a reconstruction that sleeps": (
        f"import: import time; {_METHOD}; own, calls = Method.prepare, []; "
        "Method.prepare = lambda self, problem: "
        "(calls.append(1), time.sleep(1e6) if len(calls) > 1 else own(self, problem))[1]",
        "imaging",
        "stopped by signal SIGTERM while",
    ),
    "a hook that sleeps": ("measuring: import time; time.sleep(1e6)", "press 1", ""),
    "a driver that sleeps": (
        f"import: import time; {_PRESS}; Bench.press = lambda self, *given: time.sleep(1e6)",
        "noise figure",
        "",
    ),
}


@pytest.mark.parametrize("case", _ENDLESS)
def test_what_a_plugin_does_for_ever_is_ended_by_a_signal_and_loses_nothing(case, bench, tmp_path):
    hostile, after, said = _ENDLESS[case]
    process, (_, err) = start(bench, tmp_path, hostile)
    until(lambda: after in err.read_text())
    time.sleep(1.0)
    os.kill(process.pid, signal.SIGTERM)
    process.join(timeout=100)
    assert process.exitcode == 3, err.read_text()
    assert said in err.read_text()
    run = killing.latest_run(tmp_path, "S-1")
    done = cbsr_qa(tmp_path, "run", "--resume", run, "--json", check=False, PYTHONPATH=str(bench / "site"))
    if done.returncode == 2:  # its result was stored, and its report alone is missing
        assert case == "a section that sleeps"
        cbsr_qa(tmp_path, "report", run)
    else:
        assert (done.returncode, document(done)["outcome"]) == (0, "pass")
    assert verdicts(tmp_path)[-1] == "pass"


#: Sets the clock from which the program takes date and time.
_SETS_THE_CLOCK = (
    "{place}: from cbsr_qa.system import clock; from datetime import datetime as Known, timedelta\n"
    "clock.datetime = type('Set', (Known,), dict("
    "now=classmethod(lambda cls, tz=None, own=Known.now, by=timedelta(days={days}): own(tz) + by)))"
)


@pytest.mark.parametrize("days", [-800, 3000])
@pytest.mark.parametrize("place", ["measuring", "metric"])
def test_a_clock_that_is_set_during_a_run_spoils_nothing(place, days, bench, tmp_path):
    done = run_hostile(bench, tmp_path, _SETS_THE_CLOCK.format(place=place, days=days))
    assert (done.returncode, verdicts(tmp_path)) == (0, ["pass"]), done.stderr
    which = "back" if days < 0 else "forward"
    told = [warning for warning in document(done)["warnings"] if f"clock was set {which} by" in warning]
    assert len(told) == (place == "measuring")
    cbsr_qa(tmp_path, "db", "check")
    again = document(run_hostile(bench, tmp_path, "", arguments=[*arguments_of(), "--seed", "6"]))
    assert any("one of the clocks was wrong" in warning for warning in again["warnings"]) == (days > 0)
    listed = document(cbsr_qa(tmp_path, "runs", "--json"))["runs"]
    assert [one["number"] for one in listed] == [1, 2]
    assert listed[1]["run"] == again["run"]


#: Takes all memory that a process may have, and keeps it.
_FILLS = (
    "{}: import builtins, resource; builtins.kept, size = [], 2**28; "
    "most = 2**30 + 4096 * int(open('/proc/self/statm').read().split()[0]); "
    "resource.setrlimit(resource.RLIMIT_AS, (most, most))\n"
    "while size > 64:\n  try: builtins.kept.append(bytearray(size))\n  except MemoryError: size //= 2"
)


@pytest.mark.skipif(sys.platform != "linux", reason="memory is limited as Linux does")
@pytest.mark.parametrize("place", ["measuring", "metric"])
def test_a_plugin_that_takes_all_memory_loses_nothing(place, bench, tmp_path):
    process, (_, err) = start(bench, tmp_path, _FILLS.format(place))
    process.join(timeout=100)
    assert process.exitcode in (0, 3), err.read_text()  # not left waiting, with the head down
    run = killing.latest_run(tmp_path, "S-1")
    if "finished" not in _ends(tmp_path, run) or verdicts(tmp_path)[-1:] != ["pass"]:
        cbsr_qa(tmp_path, "run", "--resume", run, PYTHONPATH=str(bench / "site"))
    assert verdicts(tmp_path)[-1] == "pass"
    assert "finished" in _ends(tmp_path, run)


def _ends(folder, run):
    with sqlite3.connect(folder / "var" / "cbsr-qa.db") as database:
        return [end for (end,) in database.execute('select "end" from run_states where run = ?', (run,))]
