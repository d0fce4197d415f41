"""A check of the emulated bench that is recorded, and made again from its transcript."""

import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_setting import context

from cbsr_qa.analysis.ring import RING
from cbsr_qa.app.station_check import bench
from cbsr_qa.app.station_check.check import check_station, replay_check
from cbsr_qa.app.station_check.request import CheckRequest
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import AbortedError, RefusedError
from cbsr_qa.domain.run.station import CheckOutcome
from cbsr_qa.plugin import Kind
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.links.recorder import Recorder
from cbsr_qa.plugin.links.transcript import digest, end_line
from cbsr_qa.store.opening import open_store
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing import assert_replays, replay_transcript

BENCH_FILE = Path(__file__).parents[3] / "stations" / "bench-emulated.toml"
BENCH = CheckRequest("bench-emulated", ring_ohm=10000.0)


def record(folder, name):
    """Record a check of a shipped station; return the folder, the transcript, and the outcome."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CBSR_QA_VAR", str(folder / "var"))
        path = folder / "bench.txt"
        outcome = check_station(CheckRequest(name, ring_ohm=10000.0, record=path))
    return folder, path, outcome.result


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return record(tmp_path_factory.mktemp("recorded"), "bench-emulated")


@pytest.fixture(scope="module")
def recorded_board(tmp_path_factory):
    """Of instruments that all send by themselves, but for the printer."""
    return record(tmp_path_factory.mktemp("board"), "board-emulated")


@pytest.mark.parametrize("station", ["recorded", "recorded_board"])
def test_the_replay_gives_the_same_frames_and_lines_in_every_bit(request, station, monkeypatch):
    from cbsr_qa.app.station_check import check

    folder, path, result = request.getfixturevalue(station)
    seen = []
    monkeypatch.setenv("CBSR_QA_VAR", str(folder / "elsewhere"))
    monkeypatch.setattr(check, "check_outcome", lambda made, ring, *_, **__: seen.append((made, ring)))
    replay_check(CheckRequest(result.station, ring_ohm=10000.0), path)
    ((replayed, ring),) = seen
    assert replayed.results == result.results
    assert [one.serial for one in replayed.instruments] == [one.serial for one in result.instruments]
    assert all(one.simulated for one in replayed.instruments)
    with open_store(f"sqlite:///{folder / 'var' / 'cbsr-qa.db'}") as store:
        stored = store.stations.read_ring(result.check)
    np.testing.assert_array_equal(ring.frames.voltages, stored.frames.voltages)
    np.testing.assert_array_equal(ring.frames.time_s, stored.frames.time_s)
    assert not (folder / "elsewhere").exists()  # nothing is stored


def test_instruments_that_only_read_are_asked_first_and_what_moves_last(recorded):
    _, _, result = recorded
    asked = [line.subject for line in result.results if line.name == "identity"]
    assert asked[0] in ("load_cell", "thermometer")
    assert asked.index("multiplexer") < asked.index("applicator")


def test_the_command_replays_with_the_options_of_the_recording(recorded, monkeypatch, capsys, tmp_path):
    _, path, result = recorded
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    assert run_guarded(["station", "check", "bench-emulated", "--replay", str(path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["check"] == "replay of bench.txt"
    assert len(document["results"]) == len(result.results)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.1, 0.5, 0.9, 0.99, 1.0])
def test_a_transcript_that_was_cut_off_replays_up_to_there_and_accuses_no_instrument(recorded, tmp_path, share):
    _, path, result = recorded
    lines = path.read_text().splitlines(keepends=True)
    kept = 10 + int(share * (len(lines) - 11))  # in the end all but the last line
    cut = tmp_path / "cut.txt"
    cut.write_text("".join(lines[:kept]))
    replayed = replay_check(BENCH, cut).result
    assert replayed.outcome is CheckOutcome.WARNING
    assert not [line for line in replayed.results if line.outcome is CheckOutcome.FAILED]
    (early,) = [line for line in replayed.results if line.name == "transcript"]
    assert early.said.startswith(f"the file was cut off after line {kept};")
    assert share == 1.0 or replayed.results[-1].outcome is CheckOutcome.NOT_DONE
    checked = [line for line in replayed.results if line.outcome is CheckOutcome.OK]
    assert [line for line in result.results if line in checked] == checked
    with pytest.raises(RefusedError, match="cut off"):
        assert_replays("bench-emulated", cut)


@pytest.mark.parametrize("step", ["put_together", "sample", "measure_ring"])
def test_a_check_that_is_stopped_keeps_its_transcript_which_replays_up_to_the_stop(
    monkeypatch, capfd, tmp_path, step
):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    path = tmp_path / "k.txt"
    with monkeypatch.context() as patch:
        patch.setattr(bench._Look, step, lambda *_: os.kill(os.getpid(), signal.SIGTERM))
        with pytest.raises(AbortedError):
            check_station(CheckRequest("bench-emulated", record=path))
    assert f"transcript {path}: kept up to the stop" in capfd.readouterr().err
    results = replay_check(CheckRequest("bench-emulated"), path).result.results
    assert not [line for line in results if line.outcome is CheckOutcome.FAILED]
    (early,) = [line for line in results if line.name == "transcript"]
    assert "stopped by signal SIGTERM (line " in early.said
    assert early.outcome is CheckOutcome.WARNING
    with pytest.raises(RefusedError, match="stopped by signal SIGTERM"):
        assert_replays("bench-emulated", path)


def test_a_full_disk_fails_the_recording_and_says_why(monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    full = property(lambda self: "No space left on device", lambda self, words: None)
    monkeypatch.setattr(Recorder, "failure", full, raising=False)
    path = tmp_path / "full.txt"
    assert run_guarded(["station", "record", "bench-emulated", "--to", str(path), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["transcript"] is None
    assert document["outcome"] == "warning"
    assert document["transcript_why"] == f"{path} is not whole: No space left on device"


def test_what_is_not_sent_any_more_fails_the_replay(recorded, tmp_path):
    """As of a driver that no longer switches its output off."""
    *lines, end = recorded[1].read_text().splitlines()
    time_text = lines[-1].split(" ")[0]
    lines.append(f"{time_text} source_meter > smua.source.output = 0\\n")
    path = tmp_path / "more.txt"
    path.write_text("".join(f"{one}\n" for one in [*lines, end_line(int(end.split()[1]) + 1, digest(lines))]))
    with pytest.raises(
        AssertionError, match=rf"source_meter, replay: line {len(lines)} has sent 'smua.*, which is not"
    ):
        assert_replays("bench-emulated", path)


def test_a_sensor_cannot_be_run_by_a_transcript(recorded, capsys):
    arguments = ["station", "check", "bench-emulated", "--replay", str(recorded[1]), "--golden", "G-1"]
    assert run_guarded(arguments) == 2
    assert "--golden" in capsys.readouterr().err


def test_a_drivers_test_replays_its_own_instrument(recorded):
    """The driver alone, at no station: its samples are those of the recorded check."""
    _, path, result = recorded
    clock, plugins = VirtualClock(), discover()
    told = replace(context(None, clock=clock), role="thermometer", options={"address": "emulated"})
    with replay_transcript(path, clock) as transcript:
        assert transcript.drivers["thermometer"] == "serial-thermometer"
        instrument = plugins.factory(Kind.INSTRUMENT, "serial-thermometer")(told)
        clock.sleep(20.0)
        samples = instrument.samples_since(0.0)
        instrument.close()
    (line,) = [line for line in result.results if line.name == "samples of temperature"]
    assert f"mean {samples.values.mean():.1f}" in line.said


def test_the_kit_makes_a_test_of_a_transcript_and_names_what_fails(recorded):
    assert_replays("bench-emulated", str(recorded[1]))
    with pytest.raises(AssertionError, match=r"reference ring, gain error: "):
        assert_replays("bench-emulated", recorded[1], ring_ohm=20000.0)


def test_a_check_without_the_ring_that_the_station_states_replays_without_it(monkeypatch, tmp_path):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    station, path = tmp_path / "ringed.toml", tmp_path / "t.txt"
    station.write_text(BENCH_FILE.read_text() + "\n[reference_ring]\nresistance_ohm = 10000.0\n")
    made = check_station(CheckRequest(str(station), ring=False, material="cbsr-8wt", record=path)).result
    assert "\nmaterial cbsr-8wt\nring none\n" in path.read_text()
    assert_replays(str(station), path)
    again = replay_check(CheckRequest(str(station)), path).result.results
    assert again == made.results


def test_an_older_transcript_which_states_no_options_replays_with_those_that_are_given(recorded, tmp_path):
    *lines, end = recorded[1].read_text().splitlines()
    lines.remove("ring 10000.0")
    path = tmp_path / "older.txt"
    path.write_text("".join(f"{one}\n" for one in [*lines, end_line(int(end.split()[1]), digest(lines))]))
    assert_replays("bench-emulated", path, ring_ohm=10000.0)
    assert not [line for line in replay_check(BENCH, path).result.results if line not in recorded[2].results]


def test_an_existing_file_is_refused_before_anything_is_opened(recorded, monkeypatch, tmp_path):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    with pytest.raises(RefusedError, match="exists already"):
        check_station(CheckRequest("bench-emulated", record=recorded[1]))


def test_the_command_names_the_transcript_and_the_station_of_another(monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    path, cell = tmp_path / "cell.txt", tmp_path / "cell.toml"
    shipped = BENCH_FILE.read_text()
    head, _, rest = shipped.partition("[instruments.source_meter]")
    cell.write_text(head + rest[rest.index("[instruments.load_cell]") :])
    assert run_guarded(["station", "record", str(cell), "--to", str(path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["transcript"] == str(path)
    together = next(line for line in document["results"] if line["name"] == "together")
    assert together["outcome"] == "not done"
    assert "frame_source, force_applicator" in together["said"]
    assert any(line["name"] == "samples of force" and line["outcome"] == "ok" for line in document["results"])
    cell.write_text(cell.read_text().replace('name = "bench-emulated"', 'name = "bench-9"'))
    assert run_guarded(["station", "check", str(cell), "--replay", str(path), "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["check"] == "replay of cell.txt, recorded at station bench-emulated"
    assert again["results"] == document["results"]
    assert (
        run_guarded(["run", "--station", str(cell), "--recipe", "golden-check", "--serial", "S-1", "--dry-run"]) == 2
    )
    assert "every run needs it" in capsys.readouterr().err


def test_frames_of_the_ring_are_taken_before_there_is_a_head(monkeypatch, tmp_path):
    """The ring of a bench without applicator and load cell reads as that of the whole bench."""
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    electrical = tmp_path / "electrical.toml"
    shipped = BENCH_FILE.read_text()
    electrical.write_text(shipped[: shipped.index("[instruments.applicator]")])
    outcome = check_station(CheckRequest(str(electrical), ring_ohm=10000.0))
    ring = {line.name: line for line in outcome.result.results if line.subject == RING}
    assert outcome.exit_code == 0
    assert abs(ring["gain error"].value) < 0.1  # exact: 0, and noise
    assert ring["worst reading"].outcome is CheckOutcome.OK


def test_a_station_whose_instruments_have_no_link_leaves_no_transcript(monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    path = tmp_path / "none.txt"
    assert run_guarded(["station", "record", "simulated", "--to", str(path)]) == 0
    assert "none: no instrument of this station has a serial port or VISA resource" in capsys.readouterr().out
    assert not path.exists()


def test_a_replay_with_another_option_says_so_and_asks_nobody_to_lift_the_head(recorded, monkeypatch, capsys):
    monkeypatch.setenv("CBSR_QA_VAR", str(recorded[0] / "unused"))
    arguments = ["station", "check", "bench-emulated", "--no-ring", "--replay", str(recorded[1]), "--json"]
    assert run_guarded(arguments) == 1
    results = json.loads(capsys.readouterr().out)["results"]
    failed = [line for line in results if line["outcome"] == "failed"]
    assert failed
    assert all("replay it with the options" in line["said"] + line["remedy"] for line in failed)
    assert not any("lift the head" in line["remedy"] for line in failed)
