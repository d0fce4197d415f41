"""A check of the emulated bench that is recorded, and made again from its transcript."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_setting import context

from cbsr_qa.analysis.ring import RING
from cbsr_qa.app.station_check.check import CheckRequest, check_station, replay_check
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.run.station import CheckOutcome
from cbsr_qa.plugin import Kind
from cbsr_qa.plugin.discovery import discover
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


def test_the_command_replays_and_names_a_transcript_that_was_cut_off(recorded, monkeypatch, capsys, tmp_path):
    _, path, result = recorded
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    ring = ["--ring-ohm", "10000"]
    assert run_guarded(["station", "check", "bench-emulated", *ring, "--replay", str(path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["check"] == "replay of bench.txt"
    assert len(document["results"]) == len(result.results)
    cut = tmp_path / "cut.txt"
    cut.write_text("".join(path.read_text().splitlines(keepends=True)[:5000]))
    assert run_guarded(["station", "check", "bench-emulated", "--replay", str(cut), "--json"]) == 2
    assert "was cut off: line 5000 is not its end" in capsys.readouterr().err


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
    assert_replays("bench-emulated", recorded[1], ring_ohm=10000.0)
    with pytest.raises(AssertionError, match=r"reference ring, gain error: "):
        assert_replays("bench-emulated", recorded[1], ring_ohm=20000.0)


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
