"""What the server of a line answers to requests that no page of it makes, and what it refuses at its start."""

import http.client
import socket
from urllib.parse import urlencode

import pytest
from command import cbsr_qa
from served_line import TOKEN

from cbsr_qa.web.application import STATIC

_SIGNED = {"Authorization": f"Bearer {TOKEN}"}
_FORM = {"Content-Type": "application/x-www-form-urlencoded"}


def _ask(line, method, path, headers=None, body=None):
    connection = http.client.HTTPConnection("127.0.0.1", line.port, timeout=10)
    try:
        connection.request(method, path, body, {**_SIGNED, **(headers or {})})
        answer = connection.getresponse()
        return answer.status, answer.read().decode("utf-8", "replace"), answer.headers
    finally:
        connection.close()


@pytest.mark.parametrize(
    ("method", "path", "headers", "body", "status"),
    [
        ("GET", "/", {"Host": "evil.example"}, None, 421),
        ("GET", "/", {"Authorization": "Bearer wrong"}, None, 401),
        ("GET", "/", {"Authorization": "Basic 0000"}, None, 401),
        ("PUT", "/", {}, "", 405),
        ("GET", "/" + "a" * 2000, {}, None, 414),
        ("GET", "/", {"X-Long": "a" * 40_000}, None, 431),
        ("POST", "/stations/bench-1/check", {"Content-Type": "application/json"}, "{}", 415),
        ("POST", "/stations/bench-1/check", _FORM, "serial=" + "a" * 20_000, 413),
        ("POST", "/stations/bench-1/check", _FORM, "serial=%ff", 400),
        ("POST", "/stations/nobody/start", _FORM, "serial=A", 404),
        ("GET", "/stations/../../../etc/passwd", {}, None, 404),
        ("GET", "/static/..%2f..%2f..%2fpyproject.toml", {}, None, 404),
        ("GET", "/runs/..%2f..%2fetc%2fpasswd/report", {}, None, 404),
        ("GET", "/runs/00000000-0000-0000-0000-000000000000/report", {}, None, 404),
        ("GET", "/stations/bench-1/image/x/1", {}, None, 404),
    ],
)
def test_requests_that_are_refused(line, method, path, headers, body, status):
    found, words, answered = _ask(line, method, path, headers, body)
    assert found == status
    assert "script-src 'self'" in answered["Content-Security-Policy"]
    assert "Traceback" not in words
    assert "root:" not in words


def test_a_cookie_changes_nothing_from_another_site(line):
    connection = http.client.HTTPConnection("127.0.0.1", line.port, timeout=10)
    connection.request("GET", f"/?token={TOKEN}")
    cookie = connection.getresponse().headers["Set-Cookie"]
    assert {"HttpOnly", "SameSite=Strict"} <= {part.strip() for part in cookie.split(";")}
    assert TOKEN not in cookie
    connection.close()
    signed = {**_FORM, "Cookie": cookie.partition(";")[0], "Authorization": ""}
    for origin in ({}, {"Origin": "http://evil.example"}, {"Origin": "null"}):
        status, words, _ = _ask(line, "POST", "/stations/bench-1/stop", {**signed, **origin}, "")
        assert (status, "own pages alone" in words) == (403, True)
    own = {**signed, "Origin": line.address}
    assert _ask(line, "POST", "/stations/bench-1/stop", own, "")[0] == 200


@pytest.mark.parametrize("serial", ["../../etc/passwd", "--resume", "a b", "é"])
def test_hostile_serials_are_refused_with_what_is_allowed(line, serial):
    status, words, _ = _ask(line, "POST", "/stations/bench-1/check", _FORM, urlencode({"serial": serial}))
    assert (status, "cannot be used" in words) == (200, True), words


def test_the_first_view_is_small_and_complete(line):
    page = _ask(line, "GET", "/stations/bench-1")[1]
    own = [_ask(line, "GET", f"/static/{name}")[1] for name in STATIC]
    assert sum(map(len, [page, *own])) < 300_000
    assert "style=" not in page
    assert "<script>" not in page


def _stream(line):
    opened = socket.create_connection(("127.0.0.1", line.port), timeout=20)
    head = f"GET /events HTTP/1.1\r\nHost: 127.0.0.1:{line.port}\r\nAuthorization: Bearer {TOKEN}\r\n\r\n"
    opened.sendall(head.encode())
    return opened


def test_two_hundred_open_pages_and_no_more_than_allowed(line):
    streams = [_stream(line) for _ in range(200)]
    try:
        assert all(one.recv(12) == b"HTTP/1.1 200" for one in streams)
        assert _ask(line, "GET", "/")[0] == 200
        more = [_stream(line) for _ in range(100)]
        streams += more
        assert b"HTTP/1.1 503" in {one.recv(12) for one in more}
        assert _ask(line, "GET", "/")[0] == 200
    finally:
        for one in streams:
            one.close()


@pytest.mark.rest
def test_a_client_that_dawdles_is_left(line):
    with socket.create_connection(("127.0.0.1", line.port), timeout=20) as slow:
        slow.sendall(b"GET / HTTP/1.1\r\nHost: ")
        assert slow.recv(100) == b""


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--station=nobody",), "nobody"),
        (("--station=simulated", "--station=simulated"), "both station 'simulated'"),
        (("--station=simulated", "--recipe=nothing"), "nothing"),
        (("--station=simulated", "--host=0.0.0.0"), "without TLS"),
        (("--station=simulated", "--certificate=a.pem"), "belong together"),
        (("--station=simulated", "--certificate=a.pem", "--key=b.pem"), "a.pem cannot be read: No such file"),
        (
            ("--station=simulated", "--certificate=bench.toml", "--key=bench.toml"),
            "certificate bench.toml and key bench.toml cannot be used: one of them is not in PEM, is damaged",
        ),
        (("--station=simulated", "--token-file=missing"), "token cannot be read from missing: No such file"),
        (("--station=simulated", "--token-file=."), "token cannot be read from .: it is a folder, not a file"),
    ],
)
def test_what_cannot_be_served_is_refused_with_why(tmp_path, options, words):
    (tmp_path / "bench.toml").write_text("[station]\n")
    done = cbsr_qa(tmp_path, "serve", "--port=0", *options, check=False)
    assert (done.returncode, words in done.stderr) == (2, True), done.stderr
    assert "Errno" not in done.stderr


def test_a_taken_port_is_named(line, tmp_path):
    done = cbsr_qa(tmp_path, "serve", "--station=simulated", f"--port={line.port}", check=False)
    assert (done.returncode, f"port {line.port}" in done.stderr) == (2, True), done.stderr
