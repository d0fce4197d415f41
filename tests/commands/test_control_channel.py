"""The channel of a real run: paused, continued and killed by others, and pestered by clients that mean no good."""

import os
import signal
import socket
import time
from contextlib import ExitStack, contextmanager
from dataclasses import replace

import command
import forked
import pytest
from command import cbsr_qa, refused
from killing import BEGIN, assert_same, came_of, latest_run, write_files
from pydantic import TypeAdapter

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.report.document import json_document
from cbsr_qa.station.control.client import RunChannel
from cbsr_qa.station.control.lock import control_socket, station_held, station_holder
from cbsr_qa.station.control.messages import ChannelLine

STATION = "simulated"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Files of a quick run whose station takes seconds."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CBSR_QA_VAR", "var")
    write_files(tmp_path)
    station = tmp_path / "station.toml"
    station.write_text(station.read_text().replace('clock = "virtual"', 'clock = "virtual"\nclock_speed = 60'))
    return tmp_path


def until(condition, longest_s=60.0):
    """Return what is true at last."""
    until_s = time.monotonic() + longest_s
    while not (found := condition()):
        assert time.monotonic() < until_s, "it does not happen"
        time.sleep(0.01)
    return found


def connected():
    try:
        return RunChannel.connect(STATION)
    except RefusedError:
        return None


@contextmanager
def running(folder, *arguments):
    """Start a run; yields its process and a connection."""
    out = [folder / "out", folder / "err"]
    process = command._forks().Process(
        target=forked.run, args=(folder, list(arguments), {"CBSR_QA_VAR": "var"}, *out)
    )
    process.start()
    try:
        with until(connected) as channel:
            yield process, channel
    finally:
        process.join(60)
        assert process.exitcode is not None, "it has not ended"


def pressing(channel):
    state = channel.ask("state")["state"]
    return state if state["load"] else None


def paused(channel):
    state = channel.ask("state")["state"]
    return state if state["paused"] else None


@pytest.fixture
def garbage():
    """Open connections that send nonsense, too much, nothing, or do not read; they are closed after the test."""
    with ExitStack() as opened:
        yield lambda: pester(opened)


def pester(opened):
    sent = (b"\0\xff\n", b"[1]\n", b'{"do": "fly"}\n', b'{"do": "answer", "prompt": true}\n', b"x" * (1 << 17), b"")
    clients = []
    for what in sent * 2:
        client = opened.enter_context(socket.socket(socket.AF_UNIX))
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        client.connect(str(control_socket(STATION)))
        client.setblocking(False)
        client.send(what)
        clients.append(client)
    for flood in clients[2:3]:
        while True:
            try:
                flood.send(b'{"do": "state"}\n' * 1000)
            except OSError:
                break


@pytest.mark.rest
def test_a_paused_run_among_clients_that_mean_no_good_is_in_every_bit_the_run_that_was_left_alone(folder, garbage):
    with running(folder, *BEGIN, "--serial", "S-1", "--operator", "Ada") as (process, channel):
        assert channel.hello["serial"] == "S-1"
        for line in (channel.hello, channel.ask("state")):
            assert json_document(TypeAdapter(ChannelLine).validate_python(line)) == line
        assert channel.hello["pid"] == station_holder(STATION).pid != os.getpid()
        until(lambda: pressing(channel))
        channel.ask("pause", by="Grace")
        garbage()
        state = until(lambda: paused(channel))
        assert (state["paused"]["by"], state["pause_wanted"]) == ("Grace", None)
        assert 0 < sum(load["done"] for load in state["loads"]) < len(state["loads"])
        with pytest.raises(RefusedError, match="paused already, by Grace"):
            channel.ask("pause", by="Ada")
        cbsr_qa(folder, "station", "continue", STATION, "--by", "Ada")
        kinds = [line["type"] for line in channel.lines()]
        assert kinds.index("run_continued") < kinds.index("run_ended")
    assert process.exitcode in (0, 1)
    assert not control_socket(STATION).exists()
    assert station_holder(STATION) is None
    come = came_of(folder, latest_run(folder, "S-1"))
    (pause,) = come.record.pauses
    assert (pause.by, pause.continued_by, come.record.end) == ("Grace", "Ada", EndReason.FINISHED)
    (folder / "station.toml").write_text((folder / "station.toml").read_text().replace("clock_speed = 60", ""))
    cbsr_qa(folder, *BEGIN, "--serial", "S-1", check=False)
    assert_same(came_of(folder, latest_run(folder, "S-1")), come)
    report = next((folder / "var" / "reports").glob(f"*{come.record.identity.run}.html")).read_text()
    assert "Paused by Grace" in report


@pytest.mark.rest
def test_a_run_killed_in_a_pause_leaves_no_lock_and_is_resumed_after_its_last_load(folder, garbage):
    with running(folder, *BEGIN, "--serial", "S-1", "--operator", "Ada") as (process, channel):
        until(lambda: pressing(channel))
        channel.ask("pause", by="Ada")
        garbage()
        done = sum(load["done"] for load in until(lambda: paused(channel))["loads"])
        assert "station 'simulated' is in use: Ada, process" in refused(folder, *BEGIN, "--serial", "S-2")
        os.kill(channel.hello["pid"], signal.SIGKILL)
    assert process.exitcode == 3
    assert control_socket(STATION).exists()
    assert latest_run(folder, "S-2") is None
    assert station_holder(STATION) is None
    with pytest.raises(RefusedError, match="no run is under way"):
        RunChannel.connect(STATION)
    run = latest_run(folder, "S-1")
    with running(folder, "run", "--resume", run, "--json") as (process, channel):
        assert sum(load["done"] for load in until(lambda: pressing(channel))["loads"]) == done
        assert channel.ask("stop", by="Ada")["ok"]
    assert process.exitcode == 3
    record = came_of(folder, run).record
    assert record.end_detail.startswith("by Ada (remote), while ")
    (pause,) = record.pauses
    assert (pause.by, pause.ended_s) == ("Ada", None)
    assert not control_socket(STATION).exists()


PROMPT = """
[[phases]]
name = "look"
sequence = "operator-prompt"
text = "Is the sheet clean?"
picture = "sheet.png"

[[phases]]
name = "noise figure\""""


def test_a_recipe_asks_with_a_picture_and_the_first_of_two_answers_counts(folder):
    recipe = folder / "recipe.toml"
    recipe.write_text(recipe.read_text().replace('\n[[phases]]\nname = "noise figure"', PROMPT, 1))
    said = refused(folder, *BEGIN, "--serial", "S-1", "--prompts", "channel")
    assert "'sheet.png' is not an image file next to the recipe" in said
    (folder / "sheet.png").touch()
    with running(folder, *BEGIN, "--serial", "S-1", "--prompts", "channel") as (_, channel):
        prompt = until(lambda: channel.ask("state")["state"]["prompt"])
        path = str(folder / "sheet.png")
        assert prompt == {"prompt": 0, "text": "Is the sheet clean?", "picture": path, "here": True}
        with RunChannel.connect(STATION) as other:
            assert other.hello["state"]["prompt"] == prompt
            other.ask("answer", by="Grace", prompt=0, text="yes, wiped")
            with pytest.raises(RefusedError, match="answered by Grace"):
                channel.ask("answer", by="Ada", prompt=0, text="no")
        until(lambda: pressing(channel))
        channel.ask("emergency", by="Ada")
    record = came_of(folder, latest_run(folder, "S-1")).record
    (asked,) = record.prompts
    assert (asked.answer, asked.by, asked.picture) == ("yes, wiped", "Grace", "sheet.png")
    assert record.end_detail.startswith("by an emergency stop by Ada (remote), while ")


@pytest.mark.rest
def test_after_an_emergency_stop_no_run_begins_before_somebody_has_confirmed_the_bench(folder):
    with running(folder, *BEGIN, "--serial", "S-1") as (_, channel):
        until(lambda: pressing(channel))
        cbsr_qa(folder, "station", "stop", STATION, "--at-once", "--by", "Ada")
    run = latest_run(folder, "S-1")
    for wanted in ([*BEGIN, "--serial", "S-2"], ["run", "--resume", run]):
        said = refused(folder, *wanted)
        assert f"an emergency stop ended run {run}, the latest at station {STATION}" in said
        assert f"cbsr-qa station confirm {STATION} --by NAME" in said
    assert "Missing option" in refused(folder, "station", "confirm", STATION)
    assert "--by is empty" in refused(folder, "station", "confirm", STATION, "--by", "")
    assert "nothing to confirm" in cbsr_qa(folder, "station", "confirm", "another", "--by", "Ada").stderr
    assert "Ada has confirmed" in cbsr_qa(folder, "station", "confirm", STATION, "--by", "Ada").stderr
    assert "nothing to confirm" in cbsr_qa(folder, "station", "confirm", STATION, "--by", "Ada").stderr
    with running(folder, "run", "--resume", run) as (_, channel):
        until(lambda: pressing(channel))
        cbsr_qa(folder, "station", "stop", STATION, "--at-once", "--by", "Ada")
    assert "an emergency stop ended" in refused(folder, "run", "--resume", run)  # this one nobody has confirmed


def test_a_signal_goes_only_to_the_process_that_holds_the_lock(folder):
    with station_held(STATION, who="Ada", doing="nothing") as holder:
        assert station_holder(STATION) == holder
        with pytest.raises(RefusedError, match="in use: Ada"), station_held(STATION, who="Bob", doing="nothing"):
            pass
        assert not replace(holder, started="1").send(signal.SIGKILL)  # the number is used again
    assert station_holder(STATION) is None
    assert not holder.send(signal.SIGKILL)  # we hold it no more
    assert not (folder / "var").exists()


@pytest.mark.parametrize("name", ["a" * 64, "Prüfplatz 1/2", "../up", ".hidden"])
def test_any_station_has_a_socket_in_a_folder_however_deep(folder, monkeypatch, name):
    for var in ("var", str(folder / ("deep" * 25))):
        monkeypatch.setenv("CBSR_QA_VAR", var)
        path = control_socket(name)
        assert len(os.fsencode(path)) < 104
        assert path.is_absolute()
        assert "/" not in path.name
        with station_held(name, who="", doing="nothing"):
            assert station_holder(name) is not None


def test_a_run_without_a_channel_is_stopped_by_a_signal(folder):
    with running(folder, *BEGIN, "--serial", "S-1") as (process, channel):
        until(lambda: pressing(channel))
        control_socket(STATION).unlink()
        cbsr_qa(folder, "station", "stop", STATION)
        process.join(60)
    assert process.exitcode == 3
    assert came_of(folder, latest_run(folder, "S-1")).record.end is EndReason.ABORTED
