"""Clients of a stream that are slow, late, killed or many delay nobody, and what they lose is counted."""

import json
import socket
import struct
import threading
import time
from contextlib import closing

import pytest

from cbsr_qa.app.stream import clients
from cbsr_qa.app.stream.clients import LARGEST_QUEUE, MOST_CLIENTS
from cbsr_qa.app.stream.messages import SCHEMA_VERSION, EndMessage, FrameMessage, HeaderMessage, json_line
from cbsr_qa.app.stream.outlets import Outlets
from cbsr_qa.domain.errors import ConfigError, RefusedError
from cbsr_qa.plugin.discovery import discover

_HEADER = HeaderMessage(
    "header", 0, "cbsr-qa-force-stream", SCHEMA_VERSION, "S-1", "disc", "c", "d", "run", True, "N", "mm", 50.0,
    "axes", "driver", "source", True, 0.1, "2027-01-01T00:00:00+00:00", (),
)  # fmt: skip


@pytest.fixture(autouse=True)
def no_alive_messages(monkeypatch):
    """A machine that is busy for a second sends none among the messages that are counted."""
    monkeypatch.setattr("cbsr_qa.app.stream.outlets._ALIVE_S", 3600.0)


def frame(sequence):
    interval, flags = (1.0, 3.0), ("unsettled",)
    return FrameMessage(
        "frame", sequence, "S-1", sequence - 1, "2027-01-01T00:00:00+00:00", 0.1 * sequence, 2.0 + sequence, interval,
        interval, 1.0, 2.0, 0.5, 1.0, True, flags, 0.0, 0, 1.5,
    )  # fmt: skip


def end(sequence):
    return EndMessage("end", sequence, "S-1", "stopped", "by a test", sequence - 1, 0, 0)


def opened(*places, write=None):
    told = []
    return Outlets(places, discover(), write=write, tell=told.append), told


def port_of(told):
    return int(told[0].rsplit(":", 1)[1])


def joined(port, *, buffer_bytes=None):
    client = socket.socket()
    if buffer_bytes:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_bytes)
    client.settimeout(20)
    client.connect(("127.0.0.1", port))
    return client


def read_all(client, begun=b""):
    """Read what is left; ``begun``: what has been read."""
    with closing(client), client.makefile("rb") as lines:
        return [json.loads(line) for line in (begun + lines.read()).splitlines()]


def test_every_client_gets_every_message_in_order_and_a_late_one_the_header_first():
    outlets, told = opened("tcp://127.0.0.1:0")
    outlets.send(_HEADER)
    first = joined(port_of(told))
    assert first.recv(1) == b"{"
    for number in range(1, 6):
        outlets.send(frame(number))
    late = joined(port_of(told))
    with late.makefile("rb") as lines:
        assert lines.readline() == json_line(_HEADER)
        outlets.send(frame(6))
        assert json.loads(lines.readline())["sequence"] == 6
        outlets.send(end(7))
        outlets.close()
        assert [json.loads(line)["type"] for line in lines] == ["end"]
    late.close()
    assert [m["sequence"] for m in read_all(first, b"{")] == list(range(8))


def test_a_client_that_does_not_read_delays_nobody_and_is_told_what_it_lost():
    outlets, told = opened("tcp://127.0.0.1:0")
    outlets.send(_HEADER)
    slow = joined(port_of(told), buffer_bytes=2048)
    assert slow.recv(1) == b"{"
    quick = joined(port_of(told))
    count = 12 * LARGEST_QUEUE
    lines = quick.makefile("r")
    received = [json.loads(lines.readline())["sequence"]]
    for number in range(1, count + 1):
        outlets.send(frame(number))
        while received[-1] < number:  # so that the quick one keeps up
            received.append(json.loads(lines.readline())["sequence"])
    assert sorted(set(received)) == list(range(count + 1))
    outlets.send(end(count + 1))
    closing_them = threading.Thread(target=outlets.close)
    closing_them.start()
    seen = read_all(slow, b"{")
    closing_them.join()
    lines.close()
    quick.close()
    dropped = [m for m in seen if m["type"] == "dropped"]
    frames = [m["sequence"] for m in seen if m["type"] == "frame"]
    assert seen[0]["type"] == "header"
    assert seen[-1]["type"] == "end"
    assert dropped[-1]["total"] == sum(m["count"] for m in dropped) == count - len(frames) > 0
    assert frames == sorted(frames)


def test_a_killed_client_is_forgotten_and_its_place_is_free():
    outlets, told = opened("tcp://127.0.0.1:0")
    stays = joined(port_of(told))
    outlets.send(_HEADER)
    assert stays.recv(6)
    number = 0
    for _ in range(2 * MOST_CLIENTS):
        killed = joined(port_of(told))
        assert killed.recv(10)
        killed.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        killed.close()  # a reset
        number += 1
        outlets.send(frame(number))
        time.sleep(0.005)
    another = joined(port_of(told))
    assert another.recv(10)
    another.close()
    outlets.close()
    rest = b"xxxxxx" + b"".join(iter(lambda: stays.recv(65536), b""))
    stays.close()
    assert rest.count(b'"type":"frame"') == number


def test_more_clients_than_are_served_are_turned_away():
    outlets, told = opened("tcp://127.0.0.1:0")
    outlets.send(_HEADER)
    clients = [joined(port_of(told)) for _ in range(MOST_CLIENTS)]
    assert all(client.recv(10) for client in clients)
    with joined(port_of(told)) as further:
        assert further.recv(10) == b""
    outlets.close()
    for client in clients:
        client.close()


def test_silence_is_filled_with_messages_that_say_that_the_stream_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr("cbsr_qa.app.stream.outlets._ALIVE_S", 0.2)
    outlets, _ = opened(f"unix:{tmp_path / 's'}")
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(10)
        client.connect(str(tmp_path / "s"))
        outlets.send(_HEADER)
        with client.makefile("r") as lines:
            assert json.loads(next(lines))["type"] == "header"
            assert json.loads(next(lines)) == {"type": "alive", "sequence": 0, "serial": "S-1"}
            outlets.close()
    assert not (tmp_path / "s").exists()


def test_a_socket_left_by_a_killed_process_is_used_again_and_one_in_use_is_not(tmp_path):
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    outlets, _ = opened(f"unix:{path}")
    with pytest.raises(RefusedError, match="in use"):
        opened(f"unix:{path}")
    outlets.close()


def test_what_standard_output_did_not_take_is_counted_at_the_end(monkeypatch):
    monkeypatch.setattr(clients, "END_S", 0.1)
    read = threading.Event()
    outlets, told = opened("-", write=lambda data: read.wait(20))
    for sequence in range(1, 11):
        outlets.send(frame(sequence))
    outlets.close()
    assert told == [
        "stream to standard output: 10 of 10 events were not delivered: the sink did not take them in time"
    ]
    read.set()


def test_a_reader_of_standard_output_that_has_gone_is_noticed():
    def broken(data):
        raise BrokenPipeError

    outlets, _ = opened("-", write=broken)
    assert outlets.over == ""
    outlets.send(_HEADER)
    for _ in range(200):
        if outlets.over:
            break
        time.sleep(0.01)
    assert outlets.over == "standard output: it has gone"
    outlets.close()


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("ftp://x", "no place that a stream can go to"),
        ("tcp://127.0.0.1", "no place"),
        ("tcp://127.0.0.1:99999", "range"),
        ("unix:", "no place"),
        ("unix:/no/such/folder/s", "No such file"),
        ("mqtt://127.0.0.1:1", "cannot be reached"),
        ("mqtt://ada:secret@127.0.0.1", "password"),
        ("mqtt://127.0.0.1/a/+/b", "topic"),
        ("-", "no standard output"),
    ],
)
def test_places_that_cannot_be_used_are_refused(place, said):
    with pytest.raises((RefusedError, ConfigError), match=said):
        opened(place)


def test_a_port_that_is_taken_is_named():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        place = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(RefusedError, match=f"{place}: Address already in use"):
            opened(place)
