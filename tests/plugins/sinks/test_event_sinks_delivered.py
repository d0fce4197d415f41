"""Sinks of events at a real file, a real Mosquitto and a real web server, which also refuse, hang and come back."""

import getpass
import json
import os
import shutil
import socket
import subprocess
import threading
from contextlib import contextmanager, suppress
from uuid import uuid4

import pytest

from cbsr_qa.domain.errors import ConfigError, DeliveryError
from cbsr_qa.testing.sinks import check_sink, example_messages
from cbsr_qa_plugins.sinks.json_lines import JsonLines
from cbsr_qa_plugins.sinks.mqtt import Mqtt
from cbsr_qa_plugins.sinks.webhook import Webhook


def lines(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


# JSON lines


def test_json_lines_arrive_in_the_file_of_the_station(tmp_path):
    station = example_messages(1)[0]["station"]
    path = tmp_path / "events" / f"{station}.jsonl"
    check_sink(JsonLines(), lambda: lines(path) if path.exists() else [])


def test_a_full_file_is_renamed_and_no_event_is_lost(tmp_path):
    sink = JsonLines(path="e.jsonl", largest_MB=0.002, kept=3)
    messages = example_messages(20)
    for message in messages:
        sink.deliver([message])
    files = sorted(tmp_path.glob("e.jsonl*"), reverse=True)
    assert files[-1].name == "e.jsonl"
    assert 1 < len(files) <= 4
    kept = [each for path in files for each in lines(path)]
    assert kept == messages[-len(kept) :]
    assert all(path.stat().st_size <= 2000 for path in files)


def test_half_a_line_of_a_power_cut_spoils_no_other_line(tmp_path):
    (tmp_path / "e.jsonl").write_text('{"half": ')
    JsonLines(path="e.jsonl").deliver(example_messages(2))
    assert [json.loads(line) for line in (tmp_path / "e.jsonl").read_text().splitlines()[1:]] == example_messages(2)


def test_names_of_a_run_add_no_level_to_a_path(tmp_path):
    message = example_messages(1)[0] | {"station": "../../bench α"}
    JsonLines(path="{station}.jsonl").deliver([message])
    assert lines(tmp_path / "_._.._bench_α.jsonl") == [message]


@pytest.mark.parametrize("obstacle", ["folder", "pipe", "full"])
def test_a_file_that_cannot_be_written_is_named(tmp_path, obstacle):
    path = tmp_path / "e.jsonl"
    if obstacle == "folder":
        path.mkdir()
    elif obstacle == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/full")
    with pytest.raises(DeliveryError, match=r"e\.jsonl cannot be written: ") as refused:
        JsonLines(path="e.jsonl").deliver(example_messages(1))
    assert not refused.value.final


# MQTT


@pytest.fixture(scope="module")
def broker():
    """The MQTT broker of this machine; skips, saying so, where none answers."""
    try:
        socket.create_connection(("127.0.0.1", 1883), timeout=3).close()
    except OSError as error:
        pytest.skip(f"no MQTT broker answers at 127.0.0.1:1883: {error}")


@contextmanager
def subscribed(topic):
    """What arrives under a topic, as (topic, message)."""
    import paho.mqtt.client as paho

    arrived, ready = [], threading.Event()
    client = paho.Client(paho.CallbackAPIVersion.VERSION2)
    client.on_message = lambda _client, _data, m: arrived.append((m.topic, json.loads(m.payload)))
    client.on_subscribe = lambda *_: ready.set()
    client.on_connect = lambda *_: client.subscribe(topic, qos=1)
    client.connect("127.0.0.1", 1883)
    client.loop_start()
    try:
        assert ready.wait(10)
        yield arrived
    finally:
        client.disconnect()
        client.loop_stop()


def test_mqtt_messages_arrive_in_order(broker):
    with subscribed(f"{(base := f'cbsr-qa-test-{uuid4().hex}')}/#") as arrived:
        check_sink(Mqtt(host="127.0.0.1", topic=base + "/{serial}/{type}"), lambda: [each for _, each in arrived])
    assert arrived[0][0] == f"{base}/{example_messages(1)[0]['serial']}/run_started"


def test_a_broker_that_is_absent_or_silent_is_named(nobody, hanging):
    with pytest.raises(DeliveryError, match=f"broker 127.0.0.1:{nobody} cannot be reached: .*refused"):
        Mqtt(host="127.0.0.1", port=nobody).deliver(example_messages(1))
    with pytest.raises(DeliveryError, match=f"broker 127.0.0.1:{hanging} does not answer within 0.2 s"):
        Mqtt(host="127.0.0.1", port=hanging, timeout_s=0.2).deliver(example_messages(1))


_ACCEPTED = bytes([0x20, 2, 0, 0])


@pytest.fixture
def false_broker():
    """Starts brokers that accept a client, answer what they are told to, and read nothing more."""
    listening, accepted = socket.create_server(("127.0.0.1", 0)), []

    def start(answer):
        def serve():
            with suppress(OSError):
                while True:
                    connection, _ = listening.accept()
                    accepted.append(connection)
                    connection.recv(100)
                    connection.sendall(answer)

        threading.Thread(target=serve, daemon=True).start()
        return listening.getsockname()[1], accepted

    yield start
    listening.shutdown(socket.SHUT_RDWR)
    listening.close()
    for connection in accepted:
        connection.close()


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        pytest.param(_ACCEPTED, "has not confirmed within 0.3 s", id="stalls"),
        pytest.param(_ACCEPTED + b"\x40\x02\x7f\xff", "has not confirmed within 0.3 s", id="confirms-another"),
        pytest.param(_ACCEPTED + b"\x30\xff\xff\xff", "has not confirmed within 0.3 s", id="half-a-message"),
        pytest.param(_ACCEPTED[:3], "does not answer within 0.3 s", id="half-an-answer"),
        pytest.param(_ACCEPTED + b"\xff" * 200, "broker 127.0.0.1", id="garbage"),
    ],
)
def test_a_broker_that_stalls_is_named_and_connected_to_again(false_broker, answer, said):
    port, accepted = false_broker(answer)
    sink = Mqtt(host="127.0.0.1", port=port, timeout_s=0.3)
    long = [{**message, "text": "x" * 1_000_000} for message in example_messages(20)]  # more than fits on the way
    for _ in range(2):
        with pytest.raises(DeliveryError, match=said) as stalled:
            sink.deliver(long)
        assert not stalled.value.final
    assert len(accepted) == 2
    sink.close()


@pytest.fixture
def own_broker(broker, tmp_path):
    """A Mosquitto of the test, with a password; started, killed and started again on one port."""
    if shutil.which("mosquitto") is None:
        pytest.skip("no MQTT broker can be started: mosquitto is not installed")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    subprocess.run(
        ["mosquitto_passwd", "-b", "-c", str(tmp_path / "passwords"), "ada", "right"], check=True, capture_output=True
    )
    configuration = tmp_path / "mosquitto.conf"
    configuration.write_text(
        f"user {getpass.getuser()}\nlistener {port} 127.0.0.1\nallow_anonymous false\n"
        f"password_file {tmp_path / 'passwords'}\n"
    )
    running = []

    def start():
        running.append(subprocess.Popen(["mosquitto", "-c", str(configuration)], stderr=subprocess.DEVNULL))
        for _ in range(1000):
            try:
                return socket.create_connection(("127.0.0.1", port), timeout=1).close()
            except OSError:
                assert running[-1].poll() is None
                threading.Event().wait(0.01)
        raise AssertionError("mosquitto does not answer")

    def stop():
        running[-1].kill()
        running[-1].wait()

    yield port, start, stop
    stop()


def test_a_broker_refuses_a_password_dies_and_comes_back(own_broker, monkeypatch):
    port, start, stop = own_broker
    start()
    options = {"host": "127.0.0.1", "port": port, "user": "ada", "password_env": "BROKER_PASSWORD"}
    monkeypatch.setenv("BROKER_PASSWORD", "wrong")
    with pytest.raises(DeliveryError, match="refuses the connection: Not authorized"):
        Mqtt(**options).deliver(example_messages(1))
    monkeypatch.setenv("BROKER_PASSWORD", "right")
    sink = Mqtt(**options, timeout_s=1.0)
    sink.deliver(example_messages(2))
    stop()
    with pytest.raises(DeliveryError):
        sink.deliver(example_messages(3))
    start()
    sink.deliver(example_messages(3))
    sink.close()


# Webhook


@pytest.mark.parametrize(
    ("sink", "options", "key"),
    [
        (JsonLines, {"path": "{operator}.jsonl"}, "path"),
        (JsonLines, {"path": "{run!r}"}, "path"),
        (JsonLines, {"path": "{run.__class__}"}, "path"),
        (JsonLines, {"path": "{run"}, "path"),
        (JsonLines, {"path": ""}, "path"),
        (Mqtt, {"host": "a b"}, "host"),
        (Mqtt, {"host": "h", "topic": "a/#"}, "topic"),
        (Mqtt, {"host": "h", "topic": "$SYS/x"}, "topic"),
        (Mqtt, {"host": "h", "qos": 3}, "qos"),
        (Mqtt, {"host": "h", "qos": True}, "qos is True\nit must be a whole number"),
        (Mqtt, {"host": "h", "password_env": "NOBODY_SET_THIS"}, "password_env"),
        (Mqtt, {"host": "h", "user": "u", "password_env": "NOBODY_SET_THIS"}, "NOBODY_SET_THIS"),
        (Mqtt, {"host": "h", "ca_file": "x.pem"}, "ca_file"),
        (Mqtt, {"host": "h", "tls": True, "ca_file": "absent.pem"}, "ca_file"),
        (Webhook, {"url": "ftp://h/"}, "url"),
        (Webhook, {"url": "http://user:secret@h/"}, "url"),
        (Webhook, {"url": "http://h/\n"}, "url"),
        (Webhook, {"url": "http://h:99999/"}, "url"),
        (Webhook, {"url": "http://h/", "token_env": "s3cret!"}, "token_env"),
        (Webhook, {"url": "http://h/", "token_header": "X: y"}, "token_header"),
    ],
)
def test_options_that_cannot_be_used_are_refused_by_name(sink, options, key):
    with pytest.raises(ConfigError, match=key) as refused:
        sink(**options)
    assert refused.value.reason or refused.value.remedy
