"""The process that forks children: it is replaced if it dies, and ends with the process that began it."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.system.fork_server import obtain_fork_server
from cbsr_qa.system.untrusted import CONTAINED, read_untrusted

pytestmark = pytest.mark.skipif(not CONTAINED, reason="nothing is forked on this platform")


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "some.h5"
    path.write_bytes(b"0123456789")
    return path


def test_all_files_are_read_by_children_of_one_server(file):
    parents = {read_untrusted(file, os.getppid, refusal=CalibrationError) for _ in range(3)}
    assert len(parents) == 1
    assert os.getpid() not in parents


def test_a_server_that_was_killed_is_replaced(file):
    server = read_untrusted(file, os.getppid, refusal=CalibrationError)
    os.kill(server, signal.SIGKILL)
    while not obtain_fork_server() or Path(f"/proc/{server}").exists():
        time.sleep(0.01)
    assert read_untrusted(file, os.getppid, refusal=CalibrationError) != server


def test_a_relative_name_is_read_in_this_process_folder(file, monkeypatch):
    read_untrusted(file, file.read_bytes, refusal=CalibrationError)
    monkeypatch.chdir(file.parent)
    read = partial(Path.read_bytes, Path(file.name))
    assert read_untrusted(Path(file.name), read, refusal=CalibrationError) == b"0123456789"


def test_the_server_ends_with_the_process_that_began_it(file):
    script = (
        "import os; from pathlib import Path; from cbsr_qa.domain.errors import RefusedError as R;"
        "from cbsr_qa.system.untrusted import read_untrusted;"
        f"print(read_untrusted(Path({str(file)!r}), os.getppid, refusal=R), flush=True); os._exit(0)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    until = time.monotonic() + 60
    while Path(f"/proc/{int(done.stdout)}").exists():
        assert time.monotonic() < until
        time.sleep(0.01)
