"""Whatever a plugin does, a run that says it passed has stored its verdict, and prints one document."""

import os
import shutil
import signal
import sqlite3
import subprocess
import time
from pathlib import Path

import pytest
from command import PROGRAM, QUICK, cbsr_qa, document, short_recipe

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
    short_recipe(folder, metrics=(*QUICK, "hostile"))
    short_recipe(folder, "without.toml", metrics=QUICK)
    return folder


def _arguments(recipe="short.toml"):
    return ["run", "--station", "simulated", "--recipe", recipe, "--serial", "S-1", "--seed", "5", "--json"]


def _run(bench, folder, hostile, *, recipe="short.toml", **options):
    for name in ("short.toml", "without.toml"):
        shutil.copy(bench / name, folder)
    return cbsr_qa(
        folder, *_arguments(recipe), check=False, HOSTILE=hostile, PYTHONPATH=str(bench / "site"), **options
    )


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
    "ends the process in a metric": ("metric: os._exit(0)", 3, "ended in the middle, with exit code 0"),
    "ends the process with 1": ("metric: os._exit(1)", 3, "ended in the middle, with exit code 1"),
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
    refused = _run(bench, tmp_path, f"{place}: raise {error}")
    assert refused.returncode == 2
    assert "there is no metric plugin named 'hostile'" in document(refused)["refused"]["reason"]
    assert "hostile failed to load: " in document(refused)["refused"]["remedy"]


def test_success_is_not_believed_where_the_database_lacks_the_verdict(bench, tmp_path):
    forged = (
        "metric: from cbsr_qa.store import analyses; analyses.save_result = lambda *given, **named: None"
    )
    done = _run(bench, tmp_path, forged)
    assert done.returncode == 3
    assert "reported success, and the database holds no verdict" in document(done)["reason"]


def test_a_run_that_was_cut_off_goes_on_by_its_name(bench, tmp_path):
    cut = document(_run(bench, tmp_path, "measuring: os._exit(0)"))
    done = cbsr_qa(tmp_path, "run", "--resume", cut["run"], "--json", PYTHONPATH=str(bench / "site"))
    assert document(done)["outcome"] == "pass"
