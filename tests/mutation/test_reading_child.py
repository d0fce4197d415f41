"""The process that reads files of unknown origin: what it may not do, and what its parent makes of its end."""

import importlib
import os
import signal
import socket
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from cbsr_qa.domain.errors import CalibrationError, RecordingError, RefusedError, RowProblem
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.system import reading_child, untrusted
from cbsr_qa.system.reading_child import Limits
from cbsr_qa.system.untrusted import CONTAINED, read_untrusted

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


def _give(made):
    return made


@pytest.mark.rest
@pytest.mark.parametrize(
    ("read", "said"),
    [
        (_loop, "some.h5 took more than 1 s of processor time, the limit for a file of its size\nit holds too much"),
        (_sleep, "some.h5 took more than 2 s, the limit for a file of its size\nthe computer may be busy: try"),
        (_hog, r"reading some.h5 needs more than 1.0 GiB of memory"),
        (_crash, r"the library that reads some.h5 crashed \(SIGSEGV\)"),
        (_exit, "the process that was reading some.h5 ended before it was done"),
    ],
)
def test_a_child_that_dies_is_a_refusal_that_names_the_file(file, monkeypatch, read, said):
    monkeypatch.setattr(reading_child, "_SECONDS", 1.0)
    monkeypatch.setattr(reading_child, "_CLOCK_FACTOR", 2.0 if read is _sleep else 60.0)
    with pytest.raises(CalibrationError, match=said):
        read_untrusted(file, read, refusal=CalibrationError)
    assert read_untrusted(file, file.read_bytes, refusal=CalibrationError) == b"0123456789"


def test_plain_data_come_back_as_they_are(file):
    made = (Indenter(13.0), np.arange(6).reshape(2, 3).T, np.zeros((0, 3)), np.float64(2.5), {"a": (1, None, "ü")})
    read = read_untrusted(file, partial(_give, made), refusal=RecordingError)
    assert (read[0], read[3], read[4]) == (made[0], made[3], made[4])
    np.testing.assert_array_equal(read[1], made[1])
    assert read[2].shape == (0, 3)
    read[1][:] = 7  # arrays can be written to


class Evil:
    """What is called when it is unpickled."""

    def __reduce__(self):
        return os.system, ("exit 3",)


def _evil():
    return Evil()


def _evil_array():
    return np.array([Evil()])


def _unnamed():
    return lambda: None


@pytest.mark.parametrize(
    "read", [_evil, _evil_array, partial(_give, socket.AF_INET), _unnamed, partial(_give, RefusedError("no"))]
)
def test_nothing_else_comes_back(file, read):
    with pytest.raises(RecordingError, match=r"some\.h5: its format plugin did not return"):
        read_untrusted(file, read, refusal=RecordingError)


def test_what_cannot_be_sent_to_a_child_is_refused(file):
    with pytest.raises(CalibrationError, match=r"some\.h5: what reads it cannot be sent to a child: .*lambda"):
        read_untrusted(file, lambda: 1, refusal=CalibrationError)


def test_a_module_that_a_child_cannot_import_is_named(file, monkeypatch, tmp_path):
    (tmp_path / "elsewhere.py").write_text("def read():\n    return 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    read = importlib.import_module("elsewhere").read
    assert read_untrusted(file, read, refusal=RecordingError) == 1
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path != str(tmp_path)])
    with pytest.raises(RuntimeError, match=r"reading some\.h5: ModuleNotFoundError: No module named 'elsewhere'"):
        read_untrusted(file, read, refusal=RecordingError)


def _refuse(why="why"):
    raise RecordingError(why, remedy="what to do", problems=(RowProblem(3, "odd", True),))


def test_refusals_come_back_whole(file):
    with pytest.raises(RecordingError) as caught:
        read_untrusted(file, _refuse, refusal=CalibrationError)
    assert (caught.value.reason, caught.value.remedy) == ("why", "what to do")
    assert caught.value.problems == (RowProblem(3, "odd", True),)


def test_a_defect_of_the_reader_is_no_refusal(file):
    with pytest.raises(RuntimeError, match=r"reading some\.h5: ZeroDivisionError"):
        read_untrusted(file, partial(divmod, 1, 0), refusal=RecordingError)


def _write(new):
    with new.open("wb", buffering=0) as file:
        return file.write(b"x")


def _open_beside(file):
    with file.open(), Path("/etc/passwd").open() as other:
        return other.read()


def _hide_beside(file):
    try:
        _open_beside(file)
    except OSError as error:
        raise RecordingError("damaged") from error


def test_no_file_is_written_and_none_opened_beside_the_one_that_is_read(file):
    with pytest.raises(RuntimeError, match="File too large"):
        read_untrusted(file, partial(_write, file.parent / "new"), refusal=RecordingError)
    for read in (_open_beside, _hide_beside):
        with pytest.raises(RecordingError, match=r"some\.h5 opens the file /etc/passwd beside it"):
            read_untrusted(file, partial(read, file), refusal=RecordingError)


def _decode(file):
    with file.open("rb"):
        return [b"ab".decode(coding) for coding in ("ascii", "latin-1", "utf-8-sig", "utf-16", "cp1252")]


def test_text_in_any_coding_is_read_while_the_file_is_open(file):
    assert read_untrusted(file, partial(_decode, file), refusal=RecordingError) == [*["ab"] * 3, "\u6261", "ab"]


@pytest.mark.parametrize("contained", [True, False])
def test_what_a_refusal_repeats_of_a_file_is_cut(file, monkeypatch, contained):
    monkeypatch.setattr(untrusted, "CONTAINED", contained)
    for said in ("x" * 60_000, "x " * 60_000):
        with pytest.raises(RecordingError, match=r"the unit x.*… \(\d+ characters\)") as refused:
            read_untrusted(file, partial(_refuse, f"the unit {said} is none"), refusal=CalibrationError)
        assert len(refused.value.reason) < 2100
        assert refused.value.remedy == "what to do"


def _print():
    return os.write(1, b"out") + os.write(2, b"err")


def test_what_a_reader_prints_is_seen_by_nobody(file, capfd):
    assert read_untrusted(file, _print, refusal=RecordingError) == 6
    assert capfd.readouterr() == ("", "")


def test_where_no_child_can_be_made_files_are_read_directly(file, monkeypatch):
    monkeypatch.setattr(untrusted, "CONTAINED", False)
    assert read_untrusted(file, os.getpid, refusal=RecordingError) == os.getpid()


def test_large_files_may_take_longer_and_more_memory():
    small, large = Limits.from_size(0), Limits.from_size(100 * 2**20)
    assert (small.seconds, small.clock_s, small.memory_bytes) == (8, 48, 2**30)
    assert (large.seconds, large.memory_bytes) == (1008, 2**30 + 1600 * 2**20)
