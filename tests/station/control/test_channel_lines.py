"""Lines of a run's channel that are no message: refused in words at both ends, and nothing breaks."""

import json
import socket

import pytest

from cbsr_qa.domain import RefusedError
from cbsr_qa.station.control.client import RunChannel
from cbsr_qa.station.control.lock import Holder
from cbsr_qa.station.control.server import _content

NO_MESSAGE = [
    (b'{"do": "continue", "do": "emergency"}', "the key 'do' appears twice in one object"),
    (b'{"do": "answer", "more": {"a": 1, "a": 2}}', "the key 'a' appears twice in one object"),
    (b'{"do": "pause", "id": NaN}', "NaN is not a number in JSON"),
    (b'{"do": "pause", "id": 1e999}', "the number 1e999 is too large"),
    (b'{"do": "pause", "id": ' + b"9" * 8000 + b"}", "the number 9{60} is too large"),
    (b"[" * 16_000, "nested more than 64 deep"),
    (b'{"do": "pause', "not JSON"),
    (b"\xff\xfe", "not JSON"),
    (b"7", "not a JSON object"),
]


@pytest.mark.parametrize(("line", "why"), NO_MESSAGE)
def test_a_run_refuses_a_request_that_could_be_read_in_two_ways(line, why):
    with pytest.raises(RefusedError, match=why):
        _content(line)


@pytest.mark.parametrize(("line", "why"), NO_MESSAGE)
def test_a_command_refuses_what_a_run_cannot_have_sent(line, why):
    here, there = socket.socketpair()
    with here, there:
        there.sendall(json.dumps({"type": "hello"}).encode() + b"\n" + line + b"\n")
        channel = RunChannel(here, 5.0)
        with pytest.raises(
            RefusedError, match=f"the run's channel sent a line that is not.*{why.removeprefix('not')}"
        ):
            next(channel.lines())


@pytest.mark.parametrize("text", [b"[" * 4000, b'{"pid": 1, "pid": 2}', b"7", b'{"pid": NaN}', b""])
def test_a_lock_file_of_somebody_else_names_nobody(text):
    assert Holder.of_text(text) is None
