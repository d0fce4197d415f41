"""``cbsr-qa stream`` as processes: both documented clients, a board on a serial line, a broker, and every end."""

import json
import shutil
import signal
import subprocess
import sys
import threading
import time
from itertools import pairwise

import pytest
from command import cbsr_qa, document
from pages import HOW_TO, TOP, blocks, commands, typed
from pydantic import TypeAdapter
from streamed import Board, loaded, messages, port_of, streaming, write_sensor

import cbsr_qa as qa
from cbsr_qa.app.stream.messages import StreamMessage, json_line
from cbsr_qa.app.stream.source import FramesFrom
from cbsr_qa.app.stream.stream import StreamRequest, stream_messages
from cbsr_qa.calibration.file.keys import new_key
from cbsr_qa.domain.errors import CbsrError
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa_plugins.hardware import replayed_recording

_PAGE = HOW_TO / "stream-forces.md"
_REFERENCE = TOP / "docs" / "reference" / "stream.md"
_FRAMES = 48
_MESSAGE = TypeAdapter(StreamMessage)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    write_sensor(folder, _FRAMES)
    return folder


@pytest.fixture(scope="module")
def applied_N(folder):
    """Newtons of ``calibration apply`` of the same frames."""
    done = document(cbsr_qa(folder, "calibration", "apply", "sensor.h5", "press.h5", "--json"))
    return [frame["force_N"] for frame in done["recordings"][0]["frames"]]


@pytest.fixture(scope="module")
def python_client(folder):
    (code,) = (block for block in blocks(_PAGE, "python") if "socket" in block)
    (folder / "client.py").write_text(code)
    return [sys.executable, str(folder / "client.py")]


@pytest.fixture(scope="module")
def c_client(folder):
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("the client in C is not compiled: there is no C compiler")
    (code,) = blocks(_PAGE, "c")
    (folder / "client.c").write_text(code)
    strict = ["-std=c11", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    subprocess.run([compiler, *strict, "client.c", "-o", "client"], cwd=folder, check=True)
    return [str(folder / "client")]


def test_the_newtons_are_those_of_calibration_apply_to_the_last_bit(folder, applied_N):
    with streaming(folder, "sensor.h5", "--station", "station.toml") as process:
        out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    header, *frames, end = messages(out)
    assert [frame["force_N"] for frame in frames] == applied_N
    assert [m["sequence"] for m in (header, *frames, end)] == list(range(_FRAMES + 2))
    assert [frame["frame"] for frame in frames] == list(range(_FRAMES))
    assert (header["serial"], header["frame_period_s"], header["simulated"]) == ("S-1", 0.0625, True)
    assert (end["why"], end["frames"], end["missed"], end["exit_code"]) == ("over", _FRAMES, 0, 0)
    for frame in frames:
        (low, high), (lowest, highest) = frame["force_68_N"], frame["force_95_N"]
        assert lowest < low <= frame["force_N"] <= high < highest
        assert frame["touch"] == (frame["x_mm"] is not None)
    assert all(abs(f["x_mm"] - 5) < 2 and abs(f["y_mm"] - 7) < 2 for f in frames if f["touch"])
    assert all(a["monotonic_s"] < b["monotonic_s"] for a, b in pairwise(frames))
    for line in out.encode().splitlines(keepends=True):  # the classes describe what is sent
        assert json_line(_MESSAGE.validate_json(line)) == line


@pytest.mark.rest
def test_both_clients_read_the_same_newtons_from_one_stream(folder, applied_N, python_client, c_client):
    with streaming(folder, "sensor.h5", "--station", "station.toml", "--to", "tcp://127.0.0.1:0") as process:
        where = ["127.0.0.1", str(port_of(process))]
        clients = [
            subprocess.Popen([*client, *where], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            for client in (python_client, c_client)
        ]
        for client in clients:
            out, err = client.communicate(timeout=120)
            read = [float(line) for line in out.splitlines()]
            assert client.returncode == 0, err
            assert len(read) > _FRAMES / 4
            assert read == applied_N[-len(read) :]


@pytest.mark.rest
def test_a_killed_client_and_one_that_does_not_read_disturb_nothing(folder, python_client):
    with streaming(folder, "sensor.h5", "--station", "station.toml", "--to", "tcp://127.0.0.1:0", "--to", "-") as one:
        where = ["127.0.0.1", str(port_of(one))]
        clients = [subprocess.Popen([*python_client, *where], stdout=subprocess.PIPE) for _ in range(2)]
        clients[0].stdout.readline()
        clients[0].kill()
        clients[1].send_signal(signal.SIGSTOP)
        out, _ = one.communicate(timeout=120)
        for client in clients:
            client.kill()
            client.communicate()
    assert [m["sequence"] for m in messages(out)] == list(range(_FRAMES + 2))


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.rest)])
def test_a_signal_ends_the_stream_with_a_message(folder, number):
    with streaming(folder, "sensor.h5", "--station", "station.toml") as process:
        begun = [process.stdout.readline() for _ in range(4)]
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
    *_, end = messages("".join(begun) + out)
    assert (end["type"], end["why"], end["exit_code"], process.returncode) == ("end", "stopped", 0, 0), err


@pytest.mark.rest
def test_a_board_on_a_serial_line_is_streamed_until_its_cable_is_pulled(folder):
    """Frames of counts, in real time, by a real driver: the first ten are of the unloaded sheet.

    A busy machine may be late by seconds with a frame, so the stream gives up after three.
    """
    options = ["-o", "format=binary", "-o", "frame_period_s=0.2", "-o", "zero_counts=32768", "--give-up", "3"]
    with Board(loaded(400, off=300, on=100)) as board:
        arguments = ["sensor.h5", "--from", "ert-board-stream", "-o", f"address={board.address}", *options]
        with streaming(folder, *arguments, "--reference", "10") as process:
            seen = [process.stdout.readline() for _ in range(12)]
            board.pull()
            out, err = process.communicate(timeout=60)
    header, *rest = messages("".join(seen) + out)
    assert header["simulated"] is False, err
    assert "changes are against the first 10 frames" in header["remarks"][0]
    frames = [m for m in rest if m["type"] == "frame"]
    assert len(frames) >= 11
    assert not any(frame["touch"] for frame in frames)
    assert rest[-2]["type"] == "interrupted"
    assert (rest[-1]["why"], rest[-1]["exit_code"], process.returncode) == ("failed", 3, 3)
    assert board.address in rest[-1]["reason"]


@pytest.mark.rest
def test_a_broker_gets_every_message_and_keeps_the_header(folder, applied_N):
    paho = pytest.importorskip("paho.mqtt.client")
    received, subscribed = [], threading.Event()
    client = paho.Client(paho.CallbackAPIVersion.VERSION2)
    client.on_message = lambda client, data, message: received.append(
        (message.topic, json.loads(message.payload or "{}"))
    )
    client.on_subscribe = lambda *_: subscribed.set()
    try:
        client.connect("127.0.0.1", 1883)
    except OSError as error:
        pytest.skip(f"no MQTT broker answers at 127.0.0.1:1883: {error}")
    topic = f"test/stream-{time.monotonic_ns()}"
    client.subscribe(f"{topic}/#")
    client.loop_start()
    assert subscribed.wait(10)
    with streaming(folder, "sensor.h5", "--station", "station.toml", "--to", f"mqtt://127.0.0.1/{topic}") as process:
        _, err = process.communicate(timeout=120)
    deadline = time.monotonic() + 10
    while received[-1][1]["type"] != "end" and time.monotonic() < deadline:
        time.sleep(0.05)
    assert process.returncode == 0, err
    assert [m["force_N"] for t, m in received if t == f"{topic}/S-1/frame"] == applied_N
    received.clear()
    subscribed.clear()
    client.unsubscribe(f"{topic}/#")
    client.subscribe(f"{topic}/#")
    while not received and time.monotonic() < deadline + 10:
        time.sleep(0.05)
    assert [(t, m["type"]) for t, m in received] == [(f"{topic}/S-1/header", "header")]
    client.publish(f"{topic}/S-1/header", b"", retain=True).wait_for_publish(5)
    client.disconnect()
    client.loop_stop()


def test_python_streams_without_a_socket(folder, applied_N, monkeypatch):
    monkeypatch.chdir(folder)
    monkeypatch.setenv("CBSR_QA_VAR", str(folder / "var"))
    assert [message.force_N for message in qa.stream("sensor.h5", station="station.toml")] == applied_N


def test_a_driver_that_raises_anything_ends_the_stream_with_its_words(folder, monkeypatch):
    closed = []
    monkeypatch.setattr(replayed_recording.ReplayedRecording, "close", lambda self: closed.append(1))
    stream = stream_messages(replayed(folder))
    header, first = next(stream), next(stream)
    monkeypatch.setattr(replayed_recording.ReplayedRecording, "acquire", lambda self, count: 1 / 0)
    end, *none = stream
    assert (header.type, first.type, end.type, none) == ("header", "frame", "end", [])
    assert (end.why, end.exit_code, closed) == ("failed", 3, [1])
    assert "ZeroDivisionError" in end.reason


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ({}, "give either a driver or a station"),
        ({"driver": "replayed-recording", "station": "simulated"}, "a driver and a station are given"),
        ({"driver": "replayed-recordin"}, "no instrument plugin named 'replayed-recordin'"),
        ({"driver": "replayed-recording", "options": {"fil": "x"}}, "fil"),
        ({"driver": "scanned-frames"}, "works through other instruments"),
        ({"driver": "ert-board-stream", "options": {"address": "emulated"}}, "only a station emulates"),
        ({"station": "simulated-strip"}, "has sensor type 'strip-40x20mm', the calibration is of a 'disc-100mm'"),
        ({"station": "no-such-station"}, "no-such-station"),
    ],
)
def test_what_cannot_be_streamed_is_refused_before_a_message(folder, source, said, monkeypatch):
    monkeypatch.setenv("CBSR_QA_VAR", str(folder / "var"))
    with pytest.raises(CbsrError, match=said):
        next(stream_messages(StreamRequest(folder / "sensor.h5", FramesFrom(**source))))


def replayed(folder, **options):
    """What is asked of the recording of a folder."""
    source = FramesFrom("replayed-recording", {"file": str(folder / "press.h5")})
    return StreamRequest(folder / "sensor.h5", source, **options)


def test_a_recording_of_another_sensor_type_is_refused(tmp_path):
    write_sensor(tmp_path, 4, sensor_type="disc-150mm")
    with pytest.raises(CbsrError, match="is of sensor type 'disc-150mm', not 'disc-100mm'"):
        next(stream_messages(replayed(tmp_path)))


def test_a_calibration_that_the_pinned_key_did_not_sign_is_not_streamed(folder):
    new_key(folder / "station.key")
    with pytest.raises(CbsrError, match="not signed, and a signature by the pinned key"):
        next(stream_messages(replayed(folder, public_key=folder / "station.key.pub")))


def test_a_recording_shorter_than_the_reference_is_refused(folder, monkeypatch):
    monkeypatch.setattr("cbsr_qa.app.stream.source.RealClock", VirtualClock)
    with pytest.raises(CbsrError, match=f"has {_FRAMES} frames; 100 are needed"):
        next(stream_messages(replayed(folder, reference=100)))


@pytest.mark.rest
def test_the_page_runs_as_printed(folder):
    (command,) = commands(_PAGE)
    assert [m["type"] for m in messages(typed(folder, command, fresh=True).stdout)][-1] == "end"
    (code,) = (block for block in blocks(_PAGE, "python") if "cbsr_qa" in block)
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True)
    assert " N at (" in done.stdout


def test_the_messages_of_the_reference_are_messages():
    shown = [line for block in blocks(_REFERENCE, "json") for line in block.splitlines()]
    assert len(shown) == 6
    for line in shown:
        assert json_line(_MESSAGE.validate_json(line)).decode() == line + "\n"
