"""Lines of a run's channel that are no message: refused in words at both ends, and nothing breaks."""

import json
import os
import socket

import pytest

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.station.control.client import RunChannel
from cbsr_qa.station.control.lock import Holder, control_socket
from cbsr_qa.station.control.server import _content, _number, _Request

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
    assert Holder.from_text(text) is None


_HELD = {"station": "bench", "pid": 1, "started": "5", "who": "Ada", "doing": "testing S-1"}


def test_a_lock_file_names_its_holder():
    assert Holder.from_text(json.dumps(_HELD).encode()) == Holder(**_HELD)


@pytest.mark.parametrize(
    "changed", [{"pid": True}, {"pid": "1"}, {"pid": 1.0}, {"pid": 0}, {"who": 3}, {"doing": None}, {"more": 1}]
)
def test_a_lock_file_with_a_value_of_another_type_names_nobody(changed):
    assert Holder.from_text(json.dumps(_HELD | changed).encode()) is None


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ({"do": True}, "'do' is true; allowed are pause, continue"),
        ({"do": ["stop"]}, r"'do' is \[\"stop\"\]; allowed are pause, continue"),
        ({"do": "pause", "by": 3}, "'by' is 3; it must be a name"),
        ({"do": "pause", "by": "x" * 99}, "'by' is \"x{59}…; it must be a name of at most 64 printable"),
        ({"do": "answer", "prompt": True}, "'prompt' is true; it must be the number of the open prompt"),
        ({"do": "answer", "prompt": 1.0}, "'prompt' is 1.0; it must be the number of the open prompt"),
        ({"do": "answer", "prompt": 1, "text": {}}, "'text' is {}; it must be text of at most 4000 characters"),
        ({"do": "pause", "id": True}, "'id' is true; allowed: a whole number or a text"),
        ({"do": "pause", "id": [1]}, r"'id' is \[1\]; allowed: a whole number or a text"),
    ],
)
def test_a_request_with_a_value_of_another_type_is_refused_with_what_is_allowed(content, why):
    with pytest.raises(RefusedError, match=why):
        (_number if "id" in content else _Request.from_content)(content)


@pytest.mark.parametrize("ok", ["false", 1, None, "yes"])
def test_a_reply_that_does_not_say_true_is_no_consent(ok):
    here, there = socket.socketpair()
    with here, there:
        for message in ({"type": "hello"}, {"type": "reply", "id": 1, "ok": ok}):
            there.sendall(json.dumps(message).encode() + b"\n")
        with pytest.raises(RefusedError, match="the run answers without saying whether it does it"):
            RunChannel(here, 5.0).ask("emergency")


@pytest.mark.skipif(os.getuid() != 0, reason="only the superuser can give a file to somebody else")
def test_the_run_of_another_user_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path))
    path = control_socket("bench-a")
    path.parent.mkdir(parents=True)
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        listening.listen()
        os.chown(path, 12345, -1)
        with pytest.raises(RefusedError, match="the run at station 'bench-a' belongs to another user"):
            RunChannel.connect("bench-a", timeout_s=0.1)


def test_without_a_run_no_channel_is_found(tmp_path, monkeypatch):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path))
    with pytest.raises(RefusedError) as caught:
        RunChannel.connect("bench-a", timeout_s=0.1)
    assert "another user" not in caught.value.reason
