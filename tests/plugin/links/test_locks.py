"""One program at a time has an instrument."""

import json
import os
import signal
import subprocess
import sys

import pytest

from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.plugin.links import locks
from cbsr_qa.plugin.links.locks import AddressLock

ADDRESS = "TCPIP::192.0.2.7::5025::SOCKET"
HOLD = f"""
import sys
from cbsr_qa.plugin.links.locks import AddressLock
sys.argv[0] = "/usr/bin/cbsr-qa"
lock = AddressLock("source_meter", {ADDRESS!r})
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(locks.tempfile, "tempdir", None)
    yield
    locks.tempfile.tempdir = None


@pytest.fixture
def second_program():
    with subprocess.Popen(
        [
            sys.executable,
            "-c",
            HOLD,
            "stream",
            "-o",
            "password=hunter2",
            "--database",
            "postgresql://lab:hunter2@host",
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as program:
        assert program.stdout.readline() == "held\n"
        yield program
        program.kill()


def test_a_second_program_is_refused_by_name(second_program):
    with pytest.raises(InstrumentError) as refused:
        AddressLock("meter", ADDRESS)
    said = str(refused.value)
    assert said.startswith(f"meter at {ADDRESS}: it is in use by process {second_program.pid} ")
    assert " (cbsr-qa stream) as source_meter since 20" in said
    assert not refused.value.retryable


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["/usr/bin/cbsr-qa", "stream", "--password", "hunter2"], "cbsr-qa stream"),
        (["cbsr-qa", "--password=hunter2", "stream"], "cbsr-qa"),
        (["/home/lab/bench.py", "hunter2"], "bench.py"),
        (["cbsr-qa"], "cbsr-qa"),
        ([""], ""),
    ],
)
def test_the_file_that_every_user_reads_holds_no_argument_of_the_command(tmp_path, monkeypatch, words, named):
    monkeypatch.setattr(locks.sys, "argv", words)
    lock = AddressLock("meter", ADDRESS)
    said = locks.lock_path(ADDRESS).read_text()
    lock.release()
    assert json.loads(said)["command"] == named
    assert "hunter2" not in said


def test_a_program_that_was_killed_keeps_nobody_out(second_program):
    os.kill(second_program.pid, signal.SIGKILL)
    second_program.wait()
    AddressLock("meter", ADDRESS).release()


def test_an_instrument_of_the_same_program_is_refused_until_the_other_is_released():
    first = AddressLock("one", ADDRESS)
    with pytest.raises(InstrumentError, match="'one' of this program has the same address") as refused:
        AddressLock("two", ADDRESS.lower() + " ")
    assert "its own address" in refused.value.remedy
    first.release()
    first.release()
    AddressLock("two", ADDRESS).release()


def test_a_link_to_a_device_is_the_device(tmp_path):
    device, link = tmp_path / "ttyUSB0", tmp_path / "by-id"
    device.touch()
    link.symlink_to(device)
    first = AddressLock("one", str(device))
    with pytest.raises(InstrumentError, match="has the same address"):
        AddressLock("two", str(link))
    first.release()


def test_a_lock_that_a_forked_worker_inherited_is_released_with_the_owner_s():
    first = AddressLock("one", ADDRESS)
    worker = os.fork()
    if worker == 0:
        signal.pause()
    try:
        first.release()
        AddressLock("two", ADDRESS).release()
    finally:
        os.kill(worker, signal.SIGKILL)
        os.waitpid(worker, 0)


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "cbsr-qa-locks").write_text("in the way")
    with pytest.raises(InstrumentError, match="cannot be locked against a second program") as refused:
        AddressLock("one", ADDRESS)
    assert str(tmp_path) in refused.value.remedy


_NAMED = {"pid": 1, "command": "cbsr-qa run", "role": "one", "since": "2026-11-28"}
_OTHERS = [
    json.dumps(_NAMED | changed).encode()
    for changed in ({"pid": True}, {"pid": "1"}, {"command": 3}, {"role": "\x1b[2J"}, {"more": 1})
]


def test_whoever_holds_an_address_is_named():
    who = locks._read_holder(json.dumps(_NAMED).encode())
    assert locks._describe_holder(who) == "process 1 (cbsr-qa run) as one since 2026-11-28"


@pytest.mark.parametrize(
    "said", [b"[" * 4000, b'{"pid": 1, "pid": 2}', b"", b'{"pid": NaN, "command": ""}', *_OTHERS]
)
def test_whoever_holds_an_address_without_a_readable_name_is_another_program(said):
    assert locks._describe_holder(locks._read_holder(said)) == "another program"
