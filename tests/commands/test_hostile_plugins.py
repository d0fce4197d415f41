"""Whatever a plugin does, a run that says it passed has stored its verdict, and prints one document."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from command import cbsr_qa, document
from hostile import FILES, arguments_of, install, run_hostile, start, until, verdicts

pytestmark = pytest.mark.rest


_THREAD = (
    "import threading, time; threading.Thread(target=time.sleep, args=(60,), name='lingering').start()"
    ";import atexit; atexit.register(time.sleep, 60)"
)


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with the plugin installed beside us, and a short recipe that names its metric."""
    return install(tmp_path_factory.mktemp("hostile"))


def test_a_plugin_that_behaves_passes(bench, tmp_path):
    done = run_hostile(bench, tmp_path, "")
    assert (done.returncode, document(done)["outcome"], verdicts(tmp_path)) == (0, "pass", ["pass"])
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
    done = run_hostile(bench, tmp_path, hostile)
    assert time.monotonic() - begun_s < 30
    assert done.returncode == code, done.stderr
    found = document(done)
    assert said in done.stdout + done.stderr
    assert verdicts(tmp_path) == (["pass"] if code == 0 else [])
    assert found.get("outcome") == ("pass" if code == 0 else "not measured" if "run" in found else None)


@pytest.mark.parametrize("place", ["import", "register"])
@pytest.mark.parametrize("error", ["SystemExit(0)", "ImportError('no gcc')"])
def test_a_plugin_that_cannot_be_loaded_is_named_by_the_run(place, error, bench, tmp_path):
    done = run_hostile(bench, tmp_path, f"{place}: raise {error}", recipe="without.toml")
    said = "plugin distribution hostile (hostile) could not be loaded: "
    (warning,) = [one for one in document(done)["warnings"] if one.startswith(said)]
    assert error.partition("(")[0] in warning
    assert warning in (tmp_path / document(done)["report"]).read_text().replace("&#39;", "'")
    dry = run_hostile(
        bench, tmp_path, f"{place}: raise {error}", arguments=(*arguments_of("without.toml"), "--dry-run")
    )
    assert warning in document(dry)["warnings"]
    refused = run_hostile(bench, tmp_path, f"{place}: raise {error}")
    assert refused.returncode == 2
    assert "metrics.hostile is no installed metric plugin" in document(refused)["refused"]["reason"]
    assert "hostile failed to load: " in document(refused)["refused"]["reason"]


def test_success_is_not_believed_where_the_database_lacks_the_verdict(bench, tmp_path):
    forged = "metric: from cbsr_qa.store.results import analyses; analyses.Analyses.save = lambda *_, **__: 'none'"
    done = run_hostile(bench, tmp_path, forged)
    assert done.returncode == 3
    assert "reported success, and the database holds no verdict" in document(done)["reason"]


@pytest.mark.parametrize("place", ["import", "measuring", "metric"])
def test_a_plugin_that_closes_all_files_ends_no_run_with_success(place, bench, tmp_path):
    done = run_hostile(bench, tmp_path, f"{place}: os.closerange(3, 256)")
    assert done.returncode == 3, done.stderr
    assert "ended without a report" in done.stdout


@pytest.mark.parametrize("text", [b"5\n", b"[1]\n", b'{"pid": 1}\n', b"\xff{"])
def test_what_a_plugin_writes_to_the_parent_is_no_report(text, bench, tmp_path):
    done = run_hostile(
        bench, tmp_path, f"metric: from cbsr_qa.cli import supervised; os.write(supervised._Child.report, {text})"
    )
    assert (done.returncode, document(done)["outcome"], verdicts(tmp_path)) == (0, "pass", ["pass"])


def test_a_run_that_was_cut_off_goes_on_by_its_name(bench, tmp_path):
    cut = document(run_hostile(bench, tmp_path, "measuring: os._exit(0)"))
    done = cbsr_qa(tmp_path, "run", "--resume", cut["run"], "--json", PYTHONPATH=str(bench / "site"))
    assert document(done)["outcome"] == "pass"


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
    process, (out, err) = start(bench, tmp_path, f"measuring: import time; {sends}; time.sleep(1)")
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
    process, (out, err) = start(bench, tmp_path, hostile, arguments=["plugins", "list", "--json"])
    process.join(timeout=15)
    assert process.exitcode == 3, err.read_text()
    assert json.loads(out.read_text())[key]["reason"] == said


def test_a_signal_that_was_ignored_stays_ignored(bench, tmp_path):
    process, (out, err) = start(bench, tmp_path, "measuring: os.kill(0, 2)", ignored=(signal.SIGINT,))
    process.join(timeout=100)
    assert (process.exitcode, json.loads(out.read_text())["end"]) == (0, "finished"), err.read_text()


def test_a_run_that_is_suspended_shows_it_and_goes_on(bench, tmp_path):
    process, (out, _) = start(bench, tmp_path, "metric: os.kill(0, 20)")
    until(lambda: _state(process.pid) == "T")
    os.kill(process.pid, signal.SIGCONT)  # as a shell's fg, but to the parent alone
    process.join(timeout=100)
    assert (process.exitcode, json.loads(out.read_text())["outcome"]) == (0, "pass")


def _state(pid):
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


def test_what_a_plugin_prints_spoils_no_commands_document(bench, tmp_path):
    said = "import: print('hello'); os.write(1, b'hello'); os.system('echo hello')"
    done = cbsr_qa(tmp_path, "plugins", "list", "--json", HOSTILE=said, PYTHONPATH=str(bench / "site"))
    assert "hostile" in [row["name"] for row in document(done)["plugins"]]
    assert done.stderr.count("hello") == 3


_RUN = ("run", *FILES, "--recipe", "short.toml")


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
    done = run_hostile(bench, tmp_path, "import: os._exit(0)", arguments=arguments)
    assert done.returncode == 3, done.stderr
    assert "ended without a report, with exit code 0: a plugin may have ended it" in done.stderr
    if "--json" in arguments:
        assert "ended without a report" in document(done)["broken"]["reason"]
    else:
        assert done.stdout == ""


def test_a_thread_of_a_plugin_holds_no_command(bench, tmp_path):
    begun_s = time.monotonic()
    done = run_hostile(bench, tmp_path, _THREAD.replace("import", "import: import", 1), arguments=("plugins", "list"))
    assert time.monotonic() - begun_s < 30
    assert done.returncode == 0
    assert "hostile" in done.stdout
    assert "warning: thread 'lingering' of a plugin is still running" in done.stderr


def test_help_needs_no_second_process():
    for arguments in (["--version"], ["run", "--help"], ["plugins", "list", "--help"]):
        start = "import os; os.fork = None; from cbsr_qa.cli.main import run_and_supervise"
        code = f"{start}; raise SystemExit(run_and_supervise({arguments}))"
        done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True, timeout=60)
        assert (done.returncode, bool(done.stdout)) == (0, True), done.stderr


@pytest.mark.parametrize("place", ["measuring", "metric"])
def test_a_plugin_that_lowers_the_limit_of_open_files_is_no_damaged_database(place, bench, tmp_path):
    lowers = "import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (8, resource.getrlimit(7)[1]))"
    done = run_hostile(bench, tmp_path, f"{place}: {lowers}")
    told = document(done)
    assert (done.returncode, told["outcome"], verdicts(tmp_path)) == (3, "not measured", [])
    assert "Too many open files in this process, whose limit is 8" in told["reason"]
    assert "ulimit -n" in told["remedy"]
    assert "restore" not in done.stderr
    assert f"cbsr-qa run --resume {told['run']}" in told["remedy"]
    resumed = run_hostile(bench, tmp_path, "", arguments=("run", "--resume", told["run"], "--json"))
    assert (resumed.returncode, verdicts(tmp_path)) == (0, ["pass"])


def test_a_run_killed_before_it_is_stored_is_started_again_not_continued(bench, tmp_path):
    kill = "import: from cbsr_qa.store.locks import Claims; Claims.hold_run = lambda *_: os.kill(os.getpid(), 9)"
    done = run_hostile(bench, tmp_path, kill)
    assert done.returncode == 3
    assert "was killed by SIGKILL; nothing of the run was stored" in done.stderr
    assert "Then start it again" in done.stderr
    assert "--resume" not in done.stderr


def test_a_run_whose_plugin_was_removed_says_what_to_install(bench, tmp_path):
    stopped = run_hostile(bench, tmp_path, "measuring: os.kill(os.getpid(), 15)")
    run = document(stopped)["run"]
    removed = cbsr_qa(tmp_path, "run", "--resume", run, "--json", check=False)
    told = document(removed)["refused"]
    assert (removed.returncode, "'hostile'" in told["reason"]) == (2, True), told
    assert "the run was begun with hostile 1.0, which is not installed now" in told["reason"]
    assert "install it again, then resume the run" in told["remedy"]
    assert "pip install hostile==1.0" in told["remedy"]
    resumed = run_hostile(bench, tmp_path, "", arguments=("run", "--resume", run, "--json"))
    assert (resumed.returncode, verdicts(tmp_path)[-1]) == (0, "pass")
