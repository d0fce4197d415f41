"""Events posted to a server: in order, with its token, refused for good or sent again, in a time of their own."""

import json
import socket
import threading
import time
from contextlib import ExitStack, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from cbsr_qa.domain.errors import DeliveryError
from cbsr_qa.station.event_sinks import Delivery
from cbsr_qa.testing.sinks import check_sink, example_messages
from cbsr_qa_plugins.sinks.webhook import Webhook


class _Server(ThreadingHTTPServer):
    """Keeps events that are posted; answers with the statuses it is given, then with 204."""

    daemon_threads = True

    def __init__(self):
        self.events, self.tokens, self.statuses = [], [], []
        super().__init__(("127.0.0.1", 0), _Handler)

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_port}/events"


class _Handler(BaseHTTPRequestHandler):
    def do_POST(self):
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.server.tokens.append(self.headers["Authorization"])
        status = self.server.statuses.pop(0) if self.server.statuses else 204
        if status == 204:
            self.server.events += body["events"]
        self.send_response(status)
        if status == 302:
            self.send_header("Location", "/elsewhere")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_):
        pass


@pytest.fixture
def server():
    with _Server() as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def test_webhook_events_arrive_in_order_with_the_token(server, monkeypatch):
    monkeypatch.setenv("HOOK_TOKEN", "s3cret")
    check_sink(Webhook(url=server.url, token_env="HOOK_TOKEN"), lambda: server.events)
    assert set(server.tokens) == {"Bearer s3cret"}


@pytest.mark.parametrize(
    ("status", "final"), [(302, False), (400, True), (401, False), (413, True), (429, False), (503, False)]
)
def test_a_refusal_is_final_where_it_would_be_the_same_again(server, status, final):
    server.statuses = [status]
    sink = Webhook(url=server.url + "?key=s3cret")
    with pytest.raises(DeliveryError, match=f"/events answers {status} ") as refused:
        sink.deliver(example_messages(1))
    assert refused.value.final is final
    assert "s3cret" not in str(refused.value)
    assert server.events == []


def test_a_server_that_is_absent_or_silent_is_named(nobody, hanging):
    with pytest.raises(DeliveryError, match=f"127.0.0.1:{nobody}/ cannot be reached: .*refused"):
        Webhook(url=f"http://127.0.0.1:{nobody}/").deliver(example_messages(1))
    with pytest.raises(DeliveryError, match=f"127.0.0.1:{hanging}/ has not answered in full within 0.2 s"):
        Webhook(url=f"http://127.0.0.1:{hanging}/", timeout_s=0.2).deliver(example_messages(1))


@pytest.fixture
def dripping():
    """Serves answers a letter at a time: returns a function that takes the part sent at once, and returns a port."""
    ended = threading.Event()

    def drip(connection, begun):
        with connection, suppress(OSError):
            connection.recv(65536)
            connection.sendall(begun)
            while not ended.wait(0.05):
                connection.sendall(b"x")

    def serve(server, begun):
        with suppress(OSError):
            while True:
                threading.Thread(target=drip, args=(server.accept()[0], begun), daemon=True).start()

    with ExitStack() as servers:

        def begin(begun):
            server = servers.enter_context(socket.create_server(("127.0.0.1", 0)))
            threading.Thread(target=serve, args=(server, begun), daemon=True).start()
            return server.getsockname()[1]

        yield begin
        ended.set()


@pytest.mark.parametrize(
    "begun",
    [b"HTTP/1.1 20", b"HTTP/1.1 204 fine\r\nX-Header: ", b"HTTP/1.1 200 fine\r\nContent-Length: 60000\r\n\r\n"],
    ids=["status", "header", "body"],
)
def test_an_answer_that_drips_ends_in_time(dripping, begun):
    begun_s = time.monotonic()
    with pytest.raises(DeliveryError, match=r"has not answered in full within 0\.3 s") as late:
        Webhook(url=f"http://127.0.0.1:{dripping(begun)}/", timeout_s=0.3).deliver(example_messages(1))
    assert not late.value.final
    assert time.monotonic() - begun_s < 10  # it would drip for ever


def test_a_refusal_whose_body_drips_is_a_refusal(dripping):
    port = dripping(b"HTTP/1.1 400 no\r\nContent-Length: 60000\r\n\r\n")
    with pytest.raises(DeliveryError, match="answers 400 no") as refused:
        Webhook(url=f"http://127.0.0.1:{port}/", timeout_s=0.3).deliver(example_messages(1))
    assert refused.value.final


def test_events_that_a_dripping_server_does_not_take_are_sent_again_and_named_as_lost(dripping, server):
    """The thread of a delivery is free again; what was not taken in the end is said."""
    sink = Webhook(url=f"http://127.0.0.1:{dripping(b'HTTP/1.1 20')}/", timeout_s=0.2)
    attempts, deliver = [], sink.deliver
    sink.deliver = lambda messages: attempts.append(len(messages)) or deliver(messages)
    delivery = Delivery("hook", sink)
    delivery.put(example_messages(1)[0])
    for _ in range(200):
        if len(attempts) > 1:
            break
        threading.Event().wait(0.05)
    delivery.end()
    delivery.wait(2.0)
    assert attempts[:2] == [1, 1]
    assert "1 of 1 events were not delivered" in delivery.describe_loss()
    assert "has not answered in full within 0.2 s" in delivery.describe_loss()


# Options
