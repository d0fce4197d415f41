"""The process that reads files of unknown origin: what it may not do, and what its parent makes of its end."""

import os
import signal
import socket
import time
from pathlib import Path

import numpy as np
import pytest

from cbsr_qa import untrusted
from cbsr_qa.domain.errors import CalibrationError, RecordingError, RefusedError
from cbsr_qa.domain.loads import Indenter
from cbsr_qa.domain.recording import RowProblem
from cbsr_qa.untrusted import CONTAINED, read_untrusted

pytestmark = pytest.mark.skipif(not CONTAINED, reason="there are no reading children on this platform")


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "some.h5"
    path.write_bytes(b"0123456789")
    return path


def _loop():
    while True:
        pass


def _sleep():
    time.sleep(60)


def _hog():
    return np.ones(2**28)


def _crash():
    os.kill(os.getpid(), signal.SIGSEGV)


def _exit():
    os._exit(0)


@pytest.mark.parametrize(
    ("read", "said"),
    [
        (_loop, "reading some.h5 took more than 1 s, the limit for a file of its size"),
        (_sleep, "reading some.h5 took more than 1 s"),
        (_hog, r"reading some.h5 needs more than 1.0 GiB of memory"),
        (_crash, r"the library that reads some.h5 crashed \(SIGSEGV\)"),
        (_exit, "the process that was reading some.h5 ended before it was done"),
    ],
)
def test_a_child_that_dies_is_a_refusal_that_names_the_file(file, monkeypatch, read, said):
    monkeypatch.setattr(untrusted, "_SECONDS", 1.0)
    with pytest.raises(CalibrationError, match=said):
        read_untrusted(file, read, refusal=CalibrationError)
    assert read_untrusted(file, file.read_bytes, refusal=CalibrationError) == b"0123456789"


def test_plain_data_come_back_as_they_are(file):
    made = (Indenter(13.0), np.arange(6).reshape(2, 3).T, np.zeros((0, 3)), np.float64(2.5), {"a": (1, None, "ü")})
    read = read_untrusted(file, lambda: made, refusal=RecordingError)
    assert (read[0], read[3], read[4]) == (made[0], made[3], made[4])
    np.testing.assert_array_equal(read[1], made[1])
    assert read[2].shape == (0, 3)
    read[1][:] = 7  # arrays can be written to


class Evil:
    """What is called when it is unpickled."""

    def __reduce__(self):
        return os.system, ("exit 3",)


@pytest.mark.parametrize(
    "made", [Evil(), np.array([Evil()]), socket.AF_INET, lambda: None, RefusedError("no")], ids=lambda m: str(type(m))
)
def test_nothing_else_comes_back(file, made):
    with pytest.raises(RecordingError, match=r"some\.h5: its format's plugin returned something other"):
        read_untrusted(file, lambda: made, refusal=RecordingError)


def test_refusals_come_back_whole(file):
    def refuse():
        raise RecordingError("why", remedy="what to do", problems=(RowProblem(3, "odd", True),))

    with pytest.raises(RecordingError) as caught:
        read_untrusted(file, refuse, refusal=CalibrationError)
    assert (caught.value.reason, caught.value.remedy) == ("why", "what to do")
    assert caught.value.problems == (RowProblem(3, "odd", True),)


def test_a_defect_of_the_reader_is_no_refusal(file):
    with pytest.raises(RuntimeError, match=r"reading some\.h5: ZeroDivisionError"):
        read_untrusted(file, lambda: 1 / 0, refusal=RecordingError)


def test_no_file_is_written_and_none_opened_beside_the_one_that_is_read(file):
    def write():
        with (file.parent / "new").open("wb", buffering=0) as new:
            return new.write(b"x")

    def beside():
        with file.open(), Path("/etc/passwd").open() as other:
            return other.read()

    for read, said in ((write, "File too large"), (beside, "Too many open files")):
        with pytest.raises(RuntimeError, match=said):
            read_untrusted(file, read, refusal=RecordingError)


def test_what_a_reader_prints_is_seen_by_nobody(file, capfd):
    read_untrusted(file, lambda: os.write(1, b"out") + os.write(2, b"err"), refusal=RecordingError)
    assert capfd.readouterr() == ("", "")


def test_where_no_child_can_be_made_files_are_read_directly(file, monkeypatch):
    monkeypatch.setattr(untrusted, "CONTAINED", False)
    assert read_untrusted(file, os.getpid, refusal=RecordingError) == os.getpid()


def test_large_files_may_take_longer_and_more_memory():
    small, large = untrusted.Limits.of(0), untrusted.Limits.of(100 * 2**20)
    assert (small.seconds, small.memory_bytes) == (8, 2**30)
    assert (large.seconds, large.memory_bytes) == (1008, 2**30 + 1600 * 2**20)
