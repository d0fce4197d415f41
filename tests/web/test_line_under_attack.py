"""A line that strangers keep busy: who has its token is still answered, an emergency stop first of all."""

import http.client
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlencode

import pytest
from served_line import GUESSED, PIN, TOKEN, until

from cbsr_qa.web.application import Site
from cbsr_qa.web.line import MAX_READ_ONLY_VIEWERS, Viewer

_PROJECT = Path(__file__).parents[2]
_FORM = {"Content-Type": "application/x-www-form-urlencoded"}
_SIGNED = {**_FORM, "Authorization": f"Bearer {TOKEN}"}
#: Longest wait on a busy machine; benchmarks.emergency_stops measures how soon an answer comes.
_ANSWER_S = 5.0


def _ask(line, method, path, headers, body=None, source="127.0.0.1"):
    connection = http.client.HTTPConnection("127.0.0.1", line.port, timeout=_ANSWER_S, source_address=(source, 0))
    try:
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read().decode(), answer.headers
    finally:
        connection.close()


def _dripping(line, request):
    """Return a connection whose first request is answered, and which has begun a second one."""
    opened = socket.create_connection(("127.0.0.1", line.port), timeout=20)
    opened.sendall(request.format(port=line.port).encode())
    if not request.startswith("POST"):
        opened.recv(4096)
    opened.sendall(b"G")
    return opened


def _is_open(connection):
    connection.setblocking(False)
    try:
        while connection.recv(65536):
            pass
        return False
    except BlockingIOError:
        return True
    except OSError:
        return False


_REQUESTS = {
    "whole": "GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n",
    "with-a-body": "GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nContent-Length: 9999\r\n\r\n",
    "pipelined": "GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n" * 3,
    "wrong-host": "GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n",
    "slow-form": (
        "POST /sign-in HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\n"
        "Content-Type: application/x-www-form-urlencoded\r\nContent-Length: 50\r\n\r\ntoken="
    ),
}


def test_an_emergency_stop_is_answered_while_four_hundred_connections_drip(line):
    with ExitStack() as opened:
        for _ in range(400):
            opened.enter_context(_dripping(line, _REQUESTS["whole"]))
        status, words, _ = _ask(line, "POST", "/stations/bench-1/emergency", _SIGNED, "")
        assert (status, "words" in words) == (200, True)


@pytest.mark.parametrize("much", ["head", "requests", "headers"])
def test_an_emergency_stop_is_answered_while_four_hundred_connections_send_much(line, much):
    attack = [f"--attack={line.port}", "--connections=400", f"--much={much}"]
    with subprocess.Popen([sys.executable, "-m", "benchmarks.emergency_stops", *attack], cwd=_PROJECT) as strangers:
        try:
            time.sleep(3.0)
            for _ in range(3):
                assert _ask(line, "POST", "/stations/bench-1/emergency", _SIGNED, "")[0] == 200
        finally:
            strangers.kill()


def test_strangers_make_room_for_strangers_but_not_for_those_who_showed_the_token(line):
    with ExitStack() as opened:
        signed = http.client.HTTPConnection("127.0.0.1", line.port, timeout=10)
        opened.callback(signed.close)
        signed.request("GET", "/", headers=_SIGNED)
        signed.getresponse().read()
        first = opened.enter_context(_dripping(line, _REQUESTS["whole"]))
        time.sleep(1.5)  # older than any that is spared as new
        for _ in range(100):
            opened.enter_context(_dripping(line, _REQUESTS["whole"]))
        until(lambda: not _is_open(first), "the end of the first connection", 10.0)
        signed.request("GET", "/", headers=_SIGNED)  # on the same connection
        assert signed.getresponse().status == 200


@pytest.mark.rest
def test_every_head_has_to_arrive_in_time(line):
    with ExitStack() as opened:
        dripping = {kind: opened.enter_context(_dripping(line, request)) for kind, request in _REQUESTS.items()}
        begun_s = time.monotonic()
        while dripping and time.monotonic() - begun_s < 40:
            time.sleep(0.5)
            for kind, connection in list(dripping.items()):
                if not _is_open(connection):
                    del dripping[kind]
                    continue
                with suppress(OSError):
                    connection.send(b"x")
        assert not dripping
        assert time.monotonic() - begun_s < 30  # ten seconds, or twenty where the head is in time and the form is not


@pytest.mark.parametrize(("control", "status"), [(False, 503), (True, 200)])
def test_pages_that_only_look_leave_room_for_those_that_control(control, status):
    lookers = SimpleNamespace(viewers={Viewer(None, control=False) for _ in range(MAX_READ_ONLY_VIEWERS)})
    site = Site(lookers, None, None)
    assert site._events(Viewer(None, control=control), list, str).status_code == status


def test_wrong_tokens_slow_down_whoever_tries_them(line):
    page = {**_FORM, "Origin": line.address}

    def sign_in(token, source):
        return _ask(line, "POST", "/sign-in", page, urlencode({"token": token}), source)

    answers = [sign_in(f"wrong-token-number-{n}", "127.0.0.7") for n in range(7)]
    assert [status for status, *_ in answers[:5]] == [401] * 5
    status, words, headers = answers[6]
    assert (status, "Too many wrong tokens" in words) == (429, True)
    assert int(headers["Retry-After"]) >= 1
    # The right one has to wait as well, in any form: otherwise guesses would not be slowed down at all.
    assert sign_in(TOKEN, "127.0.0.7")[0] == 429
    assert _ask(line, "GET", f"/?token={TOKEN}", {}, source="127.0.0.7")[0] == 429
    assert _ask(line, "GET", "/", {"Authorization": f"Bearer {TOKEN}"}, source="127.0.0.7")[0] == 429
    # An emergency stop does not wait, and neither does another computer.
    assert _ask(line, "POST", "/stations/bench-1/emergency", _SIGNED, "", "127.0.0.7")[0] == 200
    assert sign_in(TOKEN, "127.0.0.8")[0] == 303
    until(lambda: sign_in(TOKEN, "127.0.0.7")[0] == 303, "the end of the wait")


def test_the_same_wrong_token_again_is_no_other_guess(line):
    for _ in range(9):
        assert _ask(line, "GET", "/?token=an-old-token-of-it", {}, source="127.0.0.9")[0] == 401
    assert _ask(line, "GET", f"/?token={TOKEN}", {}, source="127.0.0.9")[0] == 303


def test_wrong_pins_slow_down(line):
    form = {"serial": "SLOW-1", "recipe": "five-places", "operator": GUESSED}

    def start(pin):
        return _ask(line, "POST", "/stations/dying/start", _SIGNED, urlencode({**form, "pin": pin}))[1]

    answers = [start(f"{n:04d}") for n in range(5)]
    assert all(f"not that of {GUESSED}" in words for words in answers), answers
    for n in range(5, 15):  # until the wait is so long that it cannot end before the right PIN comes
        words = start(f"{n:04d}")
        if "try again in 1 s" in words:
            time.sleep(1.1)
        elif "Too many wrong PINs" in words:
            break
    assert "Too many wrong PINs" in start(PIN)
    resumed = urlencode({"operator": GUESSED, "pin": "9999", "run": ""})
    assert "no such run" in _ask(line, "POST", "/stations/dying/resume", _SIGNED, resumed)[1]
