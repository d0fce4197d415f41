"""Files appear whole or not at all, with the permissions the user's umask leaves them."""

import csv
import errno
import io
import os
import stat
import subprocess
import sys
import threading

import pytest
from calibration_samples import sample_calibration

from cbsr_qa.calibration.file.hdf5 import write_calibration
from cbsr_qa.domain.errors import RefusedError, StoreError
from cbsr_qa.eit.mesh.files import write_mesh
from cbsr_qa.report.render import write_report
from cbsr_qa.studies.limits.propose import write_new
from cbsr_qa.system.files import FileLock, HeldError, csv_text, holder, write_atomically, writing


def plainly(path):
    with write_atomically(path) as file:
        file.write(b"x")


def mesh(path):
    write_mesh(path, sample_calibration().reconstruction.problem.mesh)


WRITERS = {
    "plain": plainly,
    "report": lambda path: write_report(path, "<!DOCTYPE html>"),
    "limits": lambda path: write_new(path, "x"),
    "calibration": lambda path: write_calibration(path, sample_calibration()),
    "mesh": mesh,
}


@pytest.fixture(params=[0o022, 0o027, 0o077, 0o002])
def umask(request):
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


@pytest.mark.parametrize("writer", WRITERS.values(), ids=WRITERS)
def test_a_file_obeys_the_umask(tmp_path, writer, umask):
    writer(tmp_path / "out.toml")
    assert stat.S_IMODE((tmp_path / "out.toml").stat().st_mode) == 0o666 & ~umask
    assert [p.name for p in tmp_path.iterdir()] == ["out.toml"]


@pytest.mark.parametrize("name", ["out", "n" * 250])
def test_what_fails_leaves_the_old_file_and_nothing_else(tmp_path, name):
    (tmp_path / name).write_bytes(b"old")
    with pytest.raises(TypeError), write_atomically(tmp_path / name) as file:
        file.write("text where bytes are due")
    assert (tmp_path / name).read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == [name]


HOLD = """
import sys
from pathlib import Path
from cbsr_qa.system.files import FileLock
lock = FileLock(Path(sys.argv[1]), b"the other one")
print("held", flush=True)
sys.stdin.read()
lock.release()
"""


@pytest.fixture
def other(tmp_path):
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path / "lock")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


@pytest.mark.parametrize("killed", [False, True])
def test_a_lock_is_held_by_one_process_and_removed_after_it(tmp_path, other, killed):
    path = tmp_path / "lock"
    with pytest.raises(HeldError) as held:
        FileLock(path, b"me")
    assert held.value.who == b"the other one"
    assert holder(path) == b"the other one"
    if killed:
        other.kill()
    else:
        other.stdin.close()
    other.wait()
    assert path.exists() is killed
    FileLock(path, b"me").release()
    assert not path.exists()


def test_looking_removes_what_a_killed_process_left(tmp_path, other):
    other.kill()
    other.wait()
    assert holder(tmp_path / "lock") is None
    assert not (tmp_path / "lock").exists()


def test_removing_locks_lets_no_two_in(tmp_path):
    # Each thread opens files of its own, so they exclude each other as programs do.
    inside, most, taken = [], [], []

    def take(count):
        while count:
            try:
                lock = FileLock(tmp_path / "lock", b"one")
            except HeldError:
                continue
            inside.append(1)
            most.append(len(inside))
            inside.pop()
            taken.append(1)
            lock.release()
            count -= 1

    threads = [threading.Thread(target=take, args=(200,)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(taken) == 800
    assert max(most) == 1
    assert not list(tmp_path.iterdir())


def test_who_only_looks_keeps_nobody_out(tmp_path):
    path, done = tmp_path / "lock", threading.Event()

    def look():
        while not done.is_set():
            holder(path)

    threads = [threading.Thread(target=look) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        for _ in range(300):
            FileLock(path, b"me").release()
    finally:
        done.set()
        for thread in threads:
            thread.join()


@pytest.mark.parametrize("begins", ["=", "+", "-", "@", "\t", "\r"])
def test_a_spreadsheet_takes_no_text_for_a_formula(begins):
    text = begins + 'HYPERLINK("x";1),2\n3'
    ((guarded, number, nothing),) = csv.reader(io.StringIO(csv_text([(text, -1.5, None)]), newline=""))
    assert (guarded, number, nothing) == ("'" + text, "-1.5", "")


@pytest.mark.parametrize(
    ("text", "cell"), [("a=1", "a=1"), ("", ""), ("'x", "'x"), ("a\udcff", "a\\udcff"), ("1.5", "1.5")]
)
def test_other_text_stays_as_it_is(text, cell):
    assert csv_text([(text,)]).rstrip("\n").strip('"') == cell


def test_an_error_in_writing_is_a_refusal_that_names_the_file_and_says_why(tmp_path):
    path = tmp_path / "file" / "x.json"
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(StoreError) as refused, writing(path, refusal=StoreError, remedy="name another"):
        path.parent.mkdir(parents=True, exist_ok=True)
    assert refused.value.reason == f"{path} cannot be written: {path.parent} is a file, not a folder"
    assert refused.value.remedy == "name another"
    refuses = pytest.raises(RefusedError, match=r"x\.json cannot be written: Not a directory")
    with refuses, writing(path), path.open("w"):
        pass


def test_without_permission_it_says_what_to_do(tmp_path):
    with pytest.raises(RefusedError) as refused, writing(tmp_path / "x.csv"):
        raise PermissionError(13, "Permission denied")
    assert refused.value.reason == f"{tmp_path / 'x.csv'} cannot be written: Permission denied"
    assert refused.value.remedy == "allow writing there, or name another file"


def test_a_full_disk_says_to_make_room(tmp_path):
    with pytest.raises(RefusedError) as refused, writing(tmp_path / "x.csv", remedy="make the folder writable"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert refused.value.reason == f"{tmp_path / 'x.csv'} cannot be written: No space left on device"
    assert refused.value.remedy == "make room on that disk, or name a place on another"
