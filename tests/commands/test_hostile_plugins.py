"""Whatever a plugin does, a run that says it passed has stored its verdict, and prints one document."""

import json
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import forked
import killing
import pytest
from command import PROGRAM, _forks, cbsr_qa, document, short_recipe
from streamed import write_sensor

from cbsr_qa.system import COPY_ENDED

pytestmark = pytest.mark.rest

_THREAD = (
    "import threading, time; threading.Thread(target=time.sleep, args=(60,), name='lingering').start()"
    ";import atexit; atexit.register(time.sleep, 60)"
)


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with the plugin installed beside us, and a short recipe that names its metric."""
    folder = tmp_path_factory.mktemp("hostile")
    information = folder / "site" / "hostile-1.0.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: hostile\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text("[cbsr_qa]\nhostile = hostile_plugin\n")
    shutil.copy(Path(__file__).with_name("hostile_plugin.py"), folder / "site")
    killing.write_files(folder)  # a scene that is quickly simulated
    short_recipe(folder, metrics=("centre-of-mass-error", "hostile"))
    short_recipe(folder, "without.toml", metrics=("centre-of-mass-error",))
    return folder


_FILES = ("--station", "station.toml", "--serial", "S-1", "--seed", "5")


def _arguments(recipe="short.toml"):
    return ["run", *_FILES, "--recipe", recipe, "--json"]


def _run(bench, folder, hostile, *, recipe="short.toml", arguments=(), **options):
    for file in bench.glob("*.toml"):
        shutil.copy(file, folder)
    given = arguments or _arguments(recipe)
    return cbsr_qa(folder, *given, check=False, HOSTILE=hostile, PYTHONPATH=str(bench / "site"), **options)


def _verdicts(folder):
    file = folder / "var" / "cbsr-qa.db"
    if not file.exists():
        return []
    with sqlite3.connect(file) as database:
        return [outcome for (outcome,) in database.execute("select outcome from analyses")]


def test_a_plugin_that_behaves_passes(bench, tmp_path):
    done = _run(bench, tmp_path, "")
    assert (done.returncode, document(done)["outcome"], _verdicts(tmp_path)) == (0, "pass", ["pass"])
    assert not any("plugin" in warning for warning in document(done)["warnings"])


#: What it does, where; how the run then ends and what its document and messages say.
_LEAVES = {
    "exits where a metric is made": ("factory: raise SystemExit(0)", 2, "metric 'hostile' failed: SystemExit: 0"),
    "exits in a metric": ("metric: raise SystemExit(0)", 0, "metric hostile failed and measured nothing: SystemExit"),
    "exits while measuring": ("measuring: raise SystemExit(0)", 0, "failed in cbsr_phase_finished: SystemExit: 0"),
    "ends the process in a metric": ("metric: os._exit(0)", 3, "without a report, with exit code 0"),
    "ends the process with 1": ("metric: os._exit(1)", 3, "without a report, with exit code 1"),
    "ends the process while measuring": ("measuring: os._exit(0)", 3, "run --resume"),
    "ends the process at import": ("import: os._exit(0)", 3, "no run had begun"),
    "crashes": ("measuring: import ctypes; ctypes.string_at(0)", 3, "was killed by SIGSEGV"),
    "aborts": ("metric: os.abort()", 3, "was killed by SIGABRT"),
    "prints": ("metric: print('PASS', flush=True)", 0, "PASS\n"),
    "prints past Python": ("metric: os.write(1, b'PASS'); os.system('echo PASS')", 0, "PASSPASS\n"),
    "leaves a thread and a hook": (f"metric: {_THREAD}", 0, "thread 'lingering' of a plugin is still running"),
}


@pytest.mark.parametrize("case", _LEAVES)
def test_no_run_passes_without_a_stored_verdict(case, bench, tmp_path):
    hostile, code, said = _LEAVES[case]
    begun_s = time.monotonic()
    done = _run(bench, tmp_path, hostile)
    assert time.monotonic() - begun_s < 30
    assert done.returncode == code, done.stderr
    found = document(done)
    assert said in done.stdout + done.stderr
    assert _verdicts(tmp_path) == (["pass"] if code == 0 else [])
    assert found.get("outcome") == ("pass" if code == 0 else "not measured" if "run" in found else None)


@pytest.mark.parametrize("place", ["import", "register"])
@pytest.mark.parametrize("error", ["SystemExit(0)", "ImportError('no gcc')"])
def test_a_plugin_that_cannot_be_loaded_is_named_by_the_run(place, error, bench, tmp_path):
    done = _run(bench, tmp_path, f"{place}: raise {error}", recipe="without.toml")
    said = "plugin distribution hostile (hostile) could not be loaded: "
    (warning,) = [one for one in document(done)["warnings"] if one.startswith(said)]
    assert error.partition("(")[0] in warning
    assert warning in (tmp_path / document(done)["report"]).read_text().replace("&#39;", "'")
    dry = _run(bench, tmp_path, f"{place}: raise {error}", arguments=(*_arguments("without.toml"), "--dry-run"))
    assert warning in document(dry)["warnings"]
    refused = _run(bench, tmp_path, f"{place}: raise {error}")
    assert refused.returncode == 2
    assert "metrics.hostile is no installed metric plugin" in document(refused)["refused"]["reason"]
    assert "hostile failed to load: " in document(refused)["refused"]["reason"]


def test_success_is_not_believed_where_the_database_lacks_the_verdict(bench, tmp_path):
    forged = "metric: from cbsr_qa.store.results import analyses; analyses.save_result = lambda *given, **named: None"
    done = _run(bench, tmp_path, forged)
    assert done.returncode == 3
    assert "reported success, and the database holds no verdict" in document(done)["reason"]


@pytest.mark.parametrize("place", ["import", "measuring", "metric"])
def test_a_plugin_that_closes_all_files_ends_no_run_with_success(place, bench, tmp_path):
    done = _run(bench, tmp_path, f"{place}: os.closerange(3, 256)")
    assert done.returncode == 3, done.stderr
    assert "ended without a report" in done.stdout


@pytest.mark.parametrize("text", [b"5\n", b"[1]\n", b'{"pid": 1}\n', b"\xff{"])
def test_what_a_plugin_writes_to_the_parent_is_no_report(text, bench, tmp_path):
    done = _run(
        bench, tmp_path, f"metric: from cbsr_qa.cli import supervised; os.write(supervised._Child.report, {text})"
    )
    assert (done.returncode, document(done)["outcome"], _verdicts(tmp_path)) == (0, "pass", ["pass"])


def test_a_run_that_was_cut_off_goes_on_by_its_name(bench, tmp_path):
    cut = document(_run(bench, tmp_path, "measuring: os._exit(0)"))
    done = cbsr_qa(tmp_path, "run", "--resume", cut["run"], "--json", PYTHONPATH=str(bench / "site"))
    assert document(done)["outcome"] == "pass"


def _job(bench, folder, hostile, *, ignored=(), arguments=()):
    """Start a run in a process group of its own; return the process and where its output goes."""
    for file in bench.glob("*.toml"):
        shutil.copy(file, folder)
    written = folder / "out", folder / "err"
    written[1].touch()  # so that it can be watched
    environment = {"CBSR_QA_VAR": "var", "HOSTILE": hostile, "PYTHONPATH": str(bench / "site")}
    given = (ignored, folder, arguments or _arguments(), environment, *written)
    process = _forks().Process(target=forked.run_as_a_job, args=given)
    process.start()
    return process, written


#: Who is sent which signal in the middle of a measurement, and how the run then says it ended.
_SIGNALS = {
    "the keyboard's, to both": ("os.kill(0, 2)", "by the operator (Ctrl-C), while"),
    "to the parent alone": ("os.kill(os.getppid(), 15)", "by signal SIGTERM, while"),
    "to the run alone": ("os.kill(os.getpid(), 15)", "by signal SIGTERM, while"),
    "the keyboard's twice": ("os.kill(0, 2); time.sleep(.5); os.kill(0, 2)", "by the operator (Ctrl-C) and at once"),
    "to the parent twice": (
        "p = os.getppid(); os.kill(p, 1); time.sleep(1); os.kill(p, 1)",
        "by signal SIGHUP and at once by a second signal",
    ),
}


@pytest.mark.parametrize("case", _SIGNALS)
def test_a_signal_reaches_the_run_once(case, bench, tmp_path):
    sends, said = _SIGNALS[case]
    process, (out, err) = _job(bench, tmp_path, f"measuring: import time; {sends}; time.sleep(1)")
    process.join(timeout=100)
    assert process.exitcode == 3, err.read_text()
    found = json.loads(out.read_text())
    assert (found["end"], found["end_detail"][: len(said)]) == ("aborted", said)


@pytest.mark.parametrize(
    ("sends", "key", "said"),
    [
        ("os.kill(0, 2)", "aborted", "stopped from the keyboard"),
        ("os.kill(os.getppid(), 2)", "aborted", "stopped from the keyboard"),
        ("os.kill(os.getppid(), 15)", "broken", "the process of the command was killed by SIGTERM"),
        ("os.kill(os.getpid(), 9)", "broken", "the process of the command was killed by SIGKILL"),
    ],
)
def test_a_signal_ends_any_command_with_a_document(sends, key, said, bench, tmp_path):
    hostile = f"import: import time; {sends}; time.sleep(20)"
    process, (out, err) = _job(bench, tmp_path, hostile, arguments=["plugins", "list", "--json"])
    process.join(timeout=15)
    assert process.exitcode == 3, err.read_text()
    assert json.loads(out.read_text())[key]["reason"] == said


def test_a_signal_that_was_ignored_stays_ignored(bench, tmp_path):
    process, (out, err) = _job(bench, tmp_path, "measuring: os.kill(0, 2)", ignored=(signal.SIGINT,))
    process.join(timeout=100)
    assert (process.exitcode, json.loads(out.read_text())["end"]) == (0, "finished"), err.read_text()


def test_a_run_that_is_suspended_shows_it_and_goes_on(bench, tmp_path):
    process, (out, _) = _job(bench, tmp_path, "metric: os.kill(0, 20)")
    _until(lambda: _state(process.pid) == "T")
    os.kill(process.pid, signal.SIGCONT)  # as a shell's fg, but to the parent alone
    process.join(timeout=100)
    assert (process.exitcode, json.loads(out.read_text())["outcome"]) == (0, "pass")


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
    process, (_, err) = _job(bench, tmp_path, hostile)
    process.join(timeout=100)
    assert process.exitcode == -signal.SIGKILL
    _until(lambda: _verdicts(tmp_path) == ["not measured"] and not list((tmp_path / "var").glob("*.lock")))
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
    process, (_, err) = _job(bench, tmp_path, _KILLS.format("factory"))
    process.join(timeout=100)
    _until(lambda: "cbsr-qa: aborted" in err.read_text())
    assert "Exception ignored" not in err.read_text()
    assert _verdicts(tmp_path) == []


def test_a_run_whose_parent_is_killed_while_it_is_computed_is_resumed(bench, tmp_path):
    process, (_, err) = _job(bench, tmp_path, _KILLS.format("metric"))
    process.join(timeout=100)
    _until(lambda: "to continue: cbsr-qa run --resume" in err.read_text())
    assert "Exception ignored" not in err.read_text()
    run = killing.latest_run(tmp_path, "S-1")
    done = cbsr_qa(tmp_path, "run", "--resume", run, "--json", PYTHONPATH=str(bench / "site"))
    assert document(done)["outcome"] == "pass"


def test_a_run_without_a_parent_and_without_readers_still_stores_its_end(bench, tmp_path):
    for file in bench.glob("*.toml"):
        shutil.copy(file, tmp_path)
    environment = {"CBSR_QA_VAR": "var", "HOSTILE": _KILLS.format("measuring"), "PYTHONPATH": str(bench / "site")}
    with subprocess.Popen(
        [str(PROGRAM), *_arguments()],
        cwd=tmp_path, env=os.environ | environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        process.stdout.close()
        process.stderr.close()
    _until(lambda: _verdicts(tmp_path) == ["not measured"])


def _until(condition):
    until_s = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < until_s
        time.sleep(0.05)


def _state(pid):
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


def test_what_a_plugin_prints_spoils_no_commands_document(bench, tmp_path):
    said = "import: print('hello'); os.write(1, b'hello'); os.system('echo hello')"
    done = cbsr_qa(tmp_path, "plugins", "list", "--json", HOSTILE=said, PYTHONPATH=str(bench / "site"))
    assert "hostile" in [row["name"] for row in document(done)["plugins"]]
    assert done.stderr.count("hello") == 3


_RUN = ("run", *_FILES, "--recipe", "short.toml")


@pytest.mark.parametrize(
    "arguments",
    [
        (*_RUN, "--why", "--help"),
        ("--", *_RUN),
        (*_RUN, "--why", "--dry-run"),
        (*_RUN, "--dry-run"),
        (*_RUN, "--why", "--help", "--json"),
        ("plugins", "list"),
        ("plugins", "list", "--json"),
        ("station", "check", "station.toml", "--json"),
    ],
    ids=" ".join,
)
def test_no_command_that_a_plugin_ends_is_silent(arguments, bench, tmp_path):
    done = _run(bench, tmp_path, "import: os._exit(0)", arguments=arguments)
    assert done.returncode == 3, done.stderr
    assert "ended without a report, with exit code 0: a plugin may have ended it" in done.stderr
    if "--json" in arguments:
        assert "ended without a report" in document(done)["broken"]["reason"]
    else:
        assert done.stdout == ""


def test_a_thread_of_a_plugin_holds_no_command(bench, tmp_path):
    begun_s = time.monotonic()
    done = _run(bench, tmp_path, _THREAD.replace("import", "import: import", 1), arguments=("plugins", "list"))
    assert time.monotonic() - begun_s < 30
    assert done.returncode == 0
    assert "hostile" in done.stdout
    assert "warning: thread 'lingering' of a plugin is still running" in done.stderr


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
    process, (_, err) = _job(bench, tmp_path, hostile)
    _until(lambda: after in err.read_text())
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
    assert _verdicts(tmp_path)[-1] == "pass"


#: Sets the clock from which the program takes date and time.
_SETS_THE_CLOCK = (
    "{place}: from cbsr_qa.system import clock; from datetime import datetime as Known, timedelta\n"
    "clock.datetime = type('Set', (Known,), dict("
    "now=classmethod(lambda cls, tz=None, own=Known.now, by=timedelta(days={days}): own(tz) + by)))"
)


@pytest.mark.parametrize("days", [-800, 3000])
@pytest.mark.parametrize("place", ["measuring", "metric"])
def test_a_clock_that_is_set_during_a_run_spoils_nothing(place, days, bench, tmp_path):
    done = _run(bench, tmp_path, _SETS_THE_CLOCK.format(place=place, days=days))
    assert (done.returncode, _verdicts(tmp_path)) == (0, ["pass"]), done.stderr
    which = "back" if days < 0 else "forward"
    told = [warning for warning in document(done)["warnings"] if f"clock was set {which} by" in warning]
    assert len(told) == (place == "measuring")
    cbsr_qa(tmp_path, "db", "check")
    again = document(_run(bench, tmp_path, "", arguments=[*_arguments(), "--seed", "6"]))
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
    process, (_, err) = _job(bench, tmp_path, _FILLS.format(place))
    process.join(timeout=100)
    assert process.exitcode in (0, 3), err.read_text()  # not left waiting, with the head down
    run = killing.latest_run(tmp_path, "S-1")
    if "finished" not in _ends(tmp_path, run) or _verdicts(tmp_path)[-1:] != ["pass"]:
        cbsr_qa(tmp_path, "run", "--resume", run, PYTHONPATH=str(bench / "site"))
    assert _verdicts(tmp_path)[-1] == "pass"
    assert "finished" in _ends(tmp_path, run)


def _ends(folder, run):
    with sqlite3.connect(folder / "var" / "cbsr-qa.db") as database:
        return [end for (end,) in database.execute('select "end" from run_states where run = ?', (run,))]


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
    done = _run(
        bench, tmp_path, _DRIVER_FORKS.format(*_SIMULATED, "acquire") if place == "driver" else f"{place}: {_FORKS}"
    )
    assert (done.returncode, document(done)["outcome"], _verdicts(tmp_path)) == (0, "pass", ["pass"]), done.stderr
    assert set(re.findall(r"copy: (\d+);", done.stderr)) == {str(COPY_ENDED)}
    assert done.stderr.count("reading the run back") == done.stderr.count("rendering the report") == 1
    assert _counted(tmp_path, "run_states") == 2


def test_a_copy_forked_while_a_run_is_analysed_again_stores_nothing(bench, tmp_path):
    _run(bench, tmp_path, "")
    again = ("reanalyse", "--fresh", "--workers", "1", "--json")
    done = _run(bench, tmp_path, f"metric: {_FORKS}", arguments=again)
    assert done.returncode == 0, done.stderr
    assert (document(done)["computed"], _counted(tmp_path, "reanalyses")) == (1, 1)
    assert set(re.findall(r"copy: (\d+);", done.stderr)) == {str(COPY_ENDED)}


def test_a_copy_forked_while_a_station_is_checked_stores_and_prints_nothing(bench, tmp_path):
    forks = _DRIVER_FORKS.format(*_SIMULATED, "identity")
    done = _run(bench, tmp_path, forks, arguments=("station", "check", "station.toml", "--json"))
    assert document(done)["station"], done.stderr
    assert _counted(tmp_path, "station_checks") == 1
    assert set(re.findall(r"copy: (\d+);", done.stderr)) == {str(COPY_ENDED)}


def test_a_copy_forked_by_the_driver_of_a_stream_sends_nothing(bench, tmp_path):
    write_sensor(tmp_path, 12)
    forks = _DRIVER_FORKS.format("replayed_recording", "ReplayedRecording", "acquire")
    given = ("stream", "sensor.h5", "--station", "played.toml")
    (tmp_path / "station.toml").rename(tmp_path / "played.toml")
    done = _run(bench, tmp_path, forks, arguments=given)
    assert done.returncode == 0, done.stderr
    messages = [json.loads(line) for line in done.stdout.splitlines()]
    assert [one["sequence"] for one in messages] == list(range(14))
    assert set(re.findall(r"copy: (\d+);", done.stderr)) == {str(COPY_ENDED)}


def test_help_needs_no_second_process():
    for arguments in (["--version"], ["run", "--help"], ["plugins", "list", "--help"]):
        code = f"import os; os.fork = None; from cbsr_qa.cli.main import ended; raise SystemExit(ended({arguments}))"
        done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True, timeout=60)
        assert (done.returncode, bool(done.stdout)) == (0, True), done.stderr
