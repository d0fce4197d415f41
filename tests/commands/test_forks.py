"""No process of the program forks while it has a database, a device, a lock or a second thread."""

import os
import subprocess
import sys

import pytest
from command import cbsr_qa, document
from filled_databases import filled
from one_press import one_press_recipe

from cbsr_qa.domain.results.measurement import Measurement

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="nothing is forked elsewhere")

#: Loaded by every Python that a command starts: writes what a process holds when it forks.
INSPECTOR = """
import os, stat, threading

def inspect():
    held = [f"thread {thread.name}" for thread in threading.enumerate() if thread is not threading.main_thread()]
    for number in os.listdir("/proc/self/fd"):
        try:
            name, kind = os.readlink(f"/proc/self/fd/{number}"), os.fstat(int(number)).st_mode
        except OSError:
            continue
        ours = stat.S_ISFIFO(kind) or name.startswith(("socket:", "/memfd:cbsr-qa-task")) or int(number) < 3
        if not ours:
            held.append(name)
    with open(os.environ["FORKS"], "a") as file:
        file.write(f"{os.getpid()} {', '.join(held) or 'nothing'}\\n")

os.register_at_fork(before=inspect)
"""
RECIPE = one_press_recipe("applied-force", "centre-of-mass-error", calibrate=True)


@pytest.fixture
def inspected(tmp_path):
    """A folder, what a command needs to have its forks written down, and what was written."""
    (tmp_path / "sitecustomize.py").write_text(INSPECTOR)
    forks = tmp_path / "forks"
    return tmp_path, {"PYTHONPATH": str(tmp_path), "FORKS": str(forks)}, lambda: forks.read_text().splitlines()


def test_a_fork_with_something_open_is_seen(inspected):
    folder, environment, written = inspected
    script = (
        "import os, threading; file = open('held', 'w'); stop = threading.Event();"
        "thread = threading.Thread(target=stop.wait, name='waits'); thread.start();"
        "child = os.fork(); child or os._exit(0); os.waitpid(child, 0); stop.set()"
    )
    subprocess.run([sys.executable, "-c", script], cwd=folder, env=os.environ | environment, check=True)
    assert [line.partition(" ")[2] for line in written()] == [f"thread waits, {folder / 'held'}"]


@pytest.mark.rest
def test_nothing_is_open_when_a_run_its_report_a_comparison_and_a_reader_fork(inspected):
    folder, environment, written = inspected
    (folder / "one-press.toml").write_text(RECIPE)

    def run_command(*arguments):
        return cbsr_qa(folder, *arguments, fresh=True, check=False, **environment)

    bench = ("--station", "bench-emulated", "--recipe", "one-press.toml")
    run = document(run_command("run", *bench, "--serial", "S-1", "--seed", "11", "--json"))
    assert run_command("report", run["run"], "--to", "again").returncode == 0
    measured = [Measurement("drift", 0.1, "%/min")]
    filled(folder / "fleet.db", [("S-1", measured, {"batch": "A"}), ("S-2", measured, {"batch": "B"})])
    compared = ("--database", "fleet.db", "--output", "compared.html")
    run_command("compare", "--by", "batch", *compared)  # of one run each: nothing is decided
    assert (folder / "compared.html").exists()
    (folder / "damaged.h5").write_bytes(b"not HDF5")
    assert run_command("calibration", "show", "damaged.h5").returncode == 2
    forks = written()
    assert len({line.split()[0] for line in forks}) >= 6  # a parent of each command, and who reads the file
    assert {line.partition(" ")[2] for line in forks} == {"nothing"}
