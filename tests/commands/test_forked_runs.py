"""Processes of a run: a copy that a plugin forks ends, and a run whose parent is killed ends in order."""

import json
import os
import re
import shutil
import signal
import sqlite3
import subprocess

import killing
import pytest
from command import PROGRAM, cbsr_qa, document
from hostile import arguments_of, install, run_hostile, start, until, verdicts
from streamed import write_sensor

from cbsr_qa.system.copies import COPY_ENDED

pytestmark = pytest.mark.rest


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with the plugin installed beside us, and a short recipe that names its metric."""
    return install(tmp_path_factory.mktemp("hostile"))


#: Forks, lets both processes go on, and says how the copy ended: the original waits for that.
_FORKS = "c = os.fork(); c and os.write(2, b'copy: %d;' % (os.waitpid(c, 0)[1] >> 8))"
#: The same whenever a method of a driver is called: its module, its class, and the method.
_DRIVER_FORKS = (
    "import: from cbsr_qa_plugins.hardware.{0} import {1} as Driver; own = Driver.{2}; "
    f"Driver.{{2}} = lambda self, *given, code={_FORKS!r}: (own(self, *given), exec(code, dict(os=os)))[0]"
)
_SIMULATED = "simulated_bench", "SimulatedBench"


def _counted(folder, table):
    with sqlite3.connect(folder / "var" / "cbsr-qa.db") as database:
        return database.execute(f"select count(*) from {table}").fetchone()[0]


@pytest.mark.parametrize("place", ["import", "register", "factory", "measuring", "metric", "driver"])
def test_a_copy_that_a_plugin_forks_neither_stores_nor_prints(place, bench, tmp_path):
    done = run_hostile(
        bench, tmp_path, _DRIVER_FORKS.format(*_SIMULATED, "acquire") if place == "driver" else f"{place}: {_FORKS}"
    )
    assert (done.returncode, document(done)["outcome"], verdicts(tmp_path)) == (0, "pass", ["pass"]), done.stderr
    assert set(re.findall(r"copy: (\d+);", done.stderr)) == {str(COPY_ENDED)}
    assert done.stderr.count("reading the run back") == done.stderr.count("rendering the report") == 1
    assert _counted(tmp_path, "run_states") == 2


@pytest.mark.parametrize("ends", ["returns", "raises"])
@pytest.mark.parametrize("place", ["register", "measuring", "metric"])
def test_a_copy_that_a_plugin_forks_in_a_thread_is_silent(place, ends, bench, tmp_path):
    after = "1 / 0" if ends == "raises" else "pass"
    act = f"def act():\n import os\n c = os.fork()\n if c: os.waitpid(c, 0)\n else: {after}\n"
    hostile = f"{place}: import threading; exec({act!r}); t = threading.Thread(target=act); t.start(); t.join()"
    done = run_hostile(bench, tmp_path, hostile)
    assert (done.returncode, document(done)["outcome"], verdicts(tmp_path)) == (0, "pass", ["pass"]), done.stderr
    assert not {"Traceback", "Exception", "Fatal"} & {*done.stderr.replace(":", " ").split()}, done.stderr


def test_a_copy_forked_while_a_run_is_analysed_again_stores_nothing(bench, tmp_path):
    run_hostile(bench, tmp_path, "")
    again = ("reanalyse", "--fresh", "--workers", "1", "--json")
    done = run_hostile(bench, tmp_path, f"metric: {_FORKS}", arguments=again)
    assert done.returncode == 0, done.stderr
    assert (document(done)["computed"], _counted(tmp_path, "reanalyses")) == (1, 1)
    assert set(re.findall(r"copy: (\d+);", done.stderr)) == {str(COPY_ENDED)}


def test_a_copy_forked_while_a_station_is_checked_stores_and_prints_nothing(bench, tmp_path):
    forks = _DRIVER_FORKS.format(*_SIMULATED, "identity")
    done = run_hostile(bench, tmp_path, forks, arguments=("station", "check", "station.toml", "--json"))
    assert document(done)["station"], done.stderr
    assert _counted(tmp_path, "station_checks") == 1
    assert set(re.findall(r"copy: (\d+);", done.stderr)) == {str(COPY_ENDED)}


def test_a_copy_forked_by_the_driver_of_a_stream_sends_nothing(bench, tmp_path):
    write_sensor(tmp_path, 12)
    forks = _DRIVER_FORKS.format("replayed_recording", "ReplayedRecording", "acquire")
    given = ("stream", "sensor.h5", "--station", "played.toml")
    (tmp_path / "station.toml").rename(tmp_path / "played.toml")
    done = run_hostile(bench, tmp_path, forks, arguments=given)
    assert done.returncode == 0, done.stderr
    messages = [json.loads(line) for line in done.stdout.splitlines()]
    assert [one["sequence"] for one in messages] == list(range(14))
    assert set(re.findall(r"copy: (\d+);", done.stderr)) == {str(COPY_ENDED)}


#: What kills the parent while the head is down, and says when the bench is made safe.
_KILLS_WHILE_PRESSED = (
    "import: import time; from cbsr_qa_plugins.hardware.simulated_bench import SimulatedBench as Bench; "
    "press, safe = Bench.press, Bench.safe_state; "
    "Bench.press = lambda self, *given: (press(self, *given), os.kill(os.getppid(), 9), time.sleep(1))[0]; "
    "Bench.safe_state = lambda self: (os.write(2, b'made safe;'), safe(self))[1]"
)
_KILLS = "{}: import time; os.kill(os.getppid(), 9); time.sleep(1)"


@pytest.mark.parametrize("hostile", [_KILLS.format("measuring"), _KILLS_WHILE_PRESSED], ids=["measuring", "pressed"])
def test_a_run_whose_parent_is_killed_stops_in_order(hostile, bench, tmp_path):
    process, (_, err) = start(bench, tmp_path, hostile)
    process.join(timeout=100)
    assert process.exitcode == -signal.SIGKILL
    until(lambda: verdicts(tmp_path) == ["not measured"] and not list((tmp_path / "var").glob("*.lock")))
    record = killing.came_of(tmp_path, killing.latest_run(tmp_path, "S-1")).record
    assert (record.end, record.end_detail[:18]) == ("aborted", "by signal SIGTERM,")
    said = err.read_text()
    assert said.count("the process that watches over this one has gone: this one stops\n") == 1
    assert "Exception ignored" not in said
    assert "Traceback" not in said
    if hostile == _KILLS_WHILE_PRESSED:
        assert "head down" in record.end_detail
        assert "made safe;" in said.partition("this one stops")[2]


def test_a_run_whose_parent_is_killed_before_it_began_closes_what_is_open(bench, tmp_path):
    process, (_, err) = start(bench, tmp_path, _KILLS.format("factory"))
    process.join(timeout=100)
    until(lambda: "cbsr-qa: aborted" in err.read_text())
    assert "Exception ignored" not in err.read_text()
    assert verdicts(tmp_path) == []


def test_a_run_whose_parent_is_killed_while_it_is_computed_is_resumed(bench, tmp_path):
    process, (_, err) = start(bench, tmp_path, _KILLS.format("metric"))
    process.join(timeout=100)
    until(lambda: "to continue: cbsr-qa run --resume" in err.read_text())
    assert "Exception ignored" not in err.read_text()
    run = killing.latest_run(tmp_path, "S-1")
    done = cbsr_qa(tmp_path, "run", "--resume", run, "--json", PYTHONPATH=str(bench / "site"))
    assert document(done)["outcome"] == "pass"


def test_a_run_without_a_parent_and_without_readers_still_stores_its_end(bench, tmp_path):
    for file in bench.glob("*.toml"):
        shutil.copy(file, tmp_path)
    environment = {"CBSR_QA_VAR": "var", "HOSTILE": _KILLS.format("measuring"), "PYTHONPATH": str(bench / "site")}
    with subprocess.Popen(
        [str(PROGRAM), *arguments_of()],
        cwd=tmp_path, env=os.environ | environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        process.stdout.close()
        process.stderr.close()
    until(lambda: verdicts(tmp_path) == ["not measured"])
