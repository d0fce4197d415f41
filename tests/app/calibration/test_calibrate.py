"""``cbsr-qa calibrate`` and ``calibration apply --pattern``: the contract of scripts, and what is refused."""

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
import pytest
from made_once import made_once
from pressed_sheets import SKIN_TOML, adjacent_pairs, issued_from_presses, pressed_sheet, some, table
from typer.testing import CliRunner

from cbsr_qa.analysis.recording.reading import read_recording_file
from cbsr_qa.analysis.recording_files import write_recording
from cbsr_qa.app.calibration.calibrate import HeldOut, press_facts
from cbsr_qa.app.stream.source import FramesFrom
from cbsr_qa.app.stream.stream import StreamRequest, stream_messages
from cbsr_qa.calibration.force.inverse import flag_names
from cbsr_qa.calibration.loading import load_calibration
from cbsr_qa.calibration.place.pairs import DistinctPairs
from cbsr_qa.calibration.runtime.press_calibration import PressCalibration
from cbsr_qa.cli.main import app
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.readings.frames import FrameBlock, ReadingFlag, Recording, ScanKind, VoltageUnit
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.system.clock import VirtualClock


def run(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)), standalone_mode=False)


def refused(*arguments):
    """Reason of a command that must be refused."""
    done = run(*arguments, "--json")
    assert done.exit_code or done.exception
    return str(done.exception)


@pytest.fixture(scope="module")
def pressed():
    return pressed_sheet(60, mirrored=True, noise=0.05)


@pytest.fixture(scope="module")
def folder(pressed):
    def make(folder):
        pressed.write(folder, labels={"force_N": pressed.force_N})
        (folder / "T.toml").write_text(SKIN_TOML)
        done = calibrated(folder, "--differences", "--output", folder / "page.html")
        assert not done.exception, done.output
        (folder / "printed.json").write_text(done.stdout)

    return made_once("calibrated from presses", make)


def recording(frames):
    """A recording of frames that our own format keeps."""
    return Recording(
        path=Path("presses.h5"), format="cbsr-recording", dataset="", scan=ScanKind.FULL, frames=frames,
        reference=None, still=False, magnitudes_only=False, clock="board",
    )  # fmt: skip


def calibrated(folder, *options, to="OUT.h5", **files):
    """Run ``calibrate`` on the tables of a folder, some of them in place of its own."""
    names = {"readings": "readings.csv", "presses": "presses.csv", "pattern": "pairs.csv", "sensor": "T.toml"}
    paths = {name: folder / file for name, file in names.items()} | files
    return run(
        "calibrate", paths["readings"], "--presses", paths["presses"], "--pattern", paths["pattern"], "--sensor-type",
        paths["sensor"], "--to", folder / to, "--json", *options,
    )  # fmt: skip


def test_what_scripts_read_is_printed(folder, pressed):
    printed = json.loads((folder / "printed.json").read_text())
    assert printed["calibration"] == str(folder / "OUT.h5")
    assert printed["used"] + len(printed["left_out"]) == 60
    assert printed["registration"]["mirrored"] is True
    assert printed["registration"]["rotation_deg"] == pytest.approx(25, abs=2)
    assert printed["registration"]["scale"] == pytest.approx(1, abs=0.03)
    assert printed["registration"]["shift_mm"] == pytest.approx([46, -408], abs=2)
    assert printed["held_out"]["place_mm"].keys() == {"mean", "stderr", "n", "not_counted"}
    assert printed["held_out"]["place_mm"]["n"] == printed["used"]
    assert printed["held_out"]["coverage"].keys() == {"68", "95"}
    assert printed["held_out"]["force_N"].keys() == {"mean", "stderr", "n", "coverage", "not_counted"}
    assert printed["held_out"]["force_N"]["mean"] < 0.3  # of 1 to 5 N
    assert printed["held_out"]["depth_mm"] is None
    assert 0 < printed["explained"] <= 1
    assert any("mirrored" in words for words in printed["warnings"])
    assert printed["place_learned"] is True
    assert printed["labels"] == {"suspected": None, "gain_mm": None}


CERTIFICATE = """
[standards.load_cell]
certificate = "K-7"
laboratory = "D-K-1"
date = {date}
due = {due}
uncertainty = 10.0
k = 2
unit = "%"
"""


@pytest.mark.rest
def test_certificates_are_kept_shown_and_widen_intervals_of_force(folder, pressed, tmp_path):
    """Ten per cent with k = 2 add 5 % of the force to its standard error, as one factor."""
    today = datetime.now(UTC).date()
    (tmp_path / "st.toml").write_text(CERTIFICATE.format(date="2026-01-02", due=today + timedelta(days=1)))
    to = tmp_path / "traced.h5"
    done = calibrated(folder, "--differences", "--standards", tmp_path / "st.toml", to=to)
    assert not done.exception, done.output
    printed = json.loads(done.stdout)
    assert printed["force_error"].startswith("scatter and load cell (U = 10 % (k = 2), certificate K-7 of D-K-1")
    assert [standard["certificate"] for standard in printed["standards"]] == ["K-7"]
    assert not [words for words in printed["warnings"] if "certificate" in words]
    shown = json.loads(run("calibration", "show", to, "--json").stdout)
    assert (shown["force_error"], shown["standards"]) == (printed["force_error"], printed["standards"])
    assert [source["name"] for source in shown["sources"]][-1] == "st.toml"
    assert shown["no_expanded_forces"] == "no budget is made of forces that are learned from labelled presses"
    bare, traced = (PressCalibration.load(path) for path in (folder / "OUT.h5", to))
    changes = pressed.changes[:6] @ DistinctPairs.from_pairs(pressed.pairs).merging
    forces = [calibration.force(calibration.places(changes)) for calibration in (bare, traced)]
    np.testing.assert_array_equal(forces[1].values, forces[0].values)
    for within in ("within_68", "within_95"):
        reach = [np.abs(getattr(force, within) - force.values[:, None]) for force in forces]
        times = 0.9945 if within == "within_68" else 1.96
        np.testing.assert_allclose(reach[1], np.hypot(reach[0], 0.05 * times * forces[0].values[:, None]))
    touches = traced.estimate_readings(traced.issued.pairs, changes, differences=True)
    np.testing.assert_allclose(touches.force.shared_stderr, 0.05 * touches.force.values)
    applied = json.loads(
        run(
            "calibration", "apply", to, folder / "readings.csv", "--pattern", folder / "pairs.csv", "--differences",
            "--json",
        ).stdout
    )  # fmt: skip
    assert applied["force_error"] == printed["force_error"]


@pytest.mark.rest
def test_doubtful_certificates_are_named_and_others_are_refused(folder, tmp_path):
    today = datetime.now(UTC).date()
    for date, due, words in (
        (today + timedelta(days=1), today + timedelta(days=9), "is dated"),
        (today - timedelta(days=9), today - timedelta(days=1), "was due on"),
    ):
        (tmp_path / "st.toml").write_text(CERTIFICATE.format(date=date, due=due))
        done = calibrated(folder, "--differences", "--standards", tmp_path / "st.toml", to=tmp_path / f"{date}.h5")
        assert words in " ".join(json.loads(done.stdout)["warnings"])
    for text, words in (
        ("[standards]\n", "states no standard"),
        ('[station]\nname = "a"\n', "is a station file, not a standards file"),
        (CERTIFICATE.format(date=today, due="2020-01-01"), "is not after the date of calibration"),
    ):
        (tmp_path / "st.toml").write_text(text)
        done = calibrated(folder, "--differences", "--standards", tmp_path / "st.toml", to=tmp_path / "no.h5")
        assert words in str(done.exception)
    assert not (tmp_path / "no.h5").exists()


def test_presses_that_are_not_counted_are_explained():
    issued = issued_from_presses()
    assert HeldOut.from_calibration(issued).place_mm.not_counted is None
    rechecked = HeldOut.from_calibration(replace(issued, used=15, held_out=12))
    assert rechecked.place_mm.not_counted == "without a re-check of 3 presses, whose errors widen regions"
    assert rechecked.force_N.n == 9
    assert rechecked.force_N.not_counted.startswith("12 are kept, evenly over the session; without a re-check of 3")


def test_few_places_state_no_coverage_of_forces_either():
    issued = issued_from_presses()
    few = HeldOut.from_calibration(replace(issued, covered_68=None, covered_95=None))
    assert few.coverage == few.force_N.coverage == {"68": None, "95": None}
    names = [name for name, _ in press_facts(replace(issued, covered_68=None, covered_95=None))]
    assert "Error of force" in names
    assert not any("hold the" in name for name in names)


def test_the_page_draws_presses_that_were_left_out(folder):
    page = (folder / "page.html").read_text()
    printed = json.loads((folder / "printed.json").read_text())
    assert "60 presses left out" in page
    assert "<svg" in page
    assert all(words in page for words in printed["warnings"])


def test_places_are_in_the_frame_of_the_presses_whatever_the_order_and_polarity(folder, pressed, tmp_path):
    rows, random = np.arange(0, 60, 3), np.random.default_rng(2)
    order = random.permutation(len(pressed.pairs))
    turned = replace(some(pressed, rows), pairs=pressed.pairs[order].copy(), changes=pressed.changes[rows][:, order])
    turned.pairs[::2] = turned.pairs[::2][:, [0, 1, 3, 2]]
    turned.changes[:, ::2] *= -1
    places = []
    for each, name in ((some(pressed, rows), "same"), (turned, "turned")):
        readings_file, _, pattern = each.write(tmp_path / name)
        done = run(
            "calibration", "apply", folder / "OUT.h5", readings_file, "--pattern", pattern, "--differences", "--json"
        )
        document = json.loads(done.stdout)
        frames = document["frames"]
        assert 0 < document["q68"] < document["q95"]
        assert all(frame["in_model"] for frame in frames)
        assert all(frame["modelled"]["in_model"] and frame["modelled"]["explained"] > 0.95 for frame in frames)
        places.append([(frame["x_mm"], frame["y_mm"], frame["force_N"]) for frame in frames])
        assert all(frame["depth_mm"] is None for frame in frames)
        assert all(frame["force_95_N"][0] < frame["force_68_N"][0] < frame["force_N"] for frame in frames)
        assert np.linalg.eigvalsh([frame["covariance_mm2"] for frame in frames]).min() > 0
    np.testing.assert_allclose(places[0], places[1], atol=1e-6)
    found = np.array(places[0])
    assert np.linalg.norm(found[:, :2] - pressed.labels_mm[rows], axis=1).mean() < 4
    assert np.abs(found[:, 2] - pressed.force_N[rows]).mean() < 0.3


def test_where_nothing_is_pressed_there_is_no_force(pressed, folder, tmp_path):
    files = some(replace(pressed, changes=1e-3 * pressed.changes), [0, 1]).write(tmp_path)
    done = run("calibration", "apply", folder / "OUT.h5", files[0], "--pattern", files[2], "--differences", "--json")
    for frame in json.loads(done.stdout)["frames"]:
        assert "not_detected" in frame["flags"]
        assert frame["force_N"] is None


def test_places_are_written_as_a_table(folder, tmp_path):
    out = tmp_path / "places.csv"
    arguments = [
        "calibration",
        "apply",
        folder / "OUT.h5",
        folder / "readings.csv",
        "--pattern",
        folder / "pairs.csv",
    ]
    shown = run(*arguments, "--differences").output
    assert "60 of 60 frames" in " ".join(shown.split())
    assert not run(*arguments, "--differences", "--output", out).exception
    header, *rows = out.read_text().splitlines()
    assert header.startswith("row,x_mm,y_mm,covariance_xx_mm2")
    assert header.endswith(",q68,q95")
    first = dict(zip(header.split(","), rows[0].split(","), strict=True))
    assert (first["row"], 0 < float(first["q68"]) < float(first["q95"])) == ("1", True)
    assert "force_N,force_68_low_N,force_68_high_N" in header
    assert len(rows) == 60
    assert len(rows[0].split(",")) == len(header.split(","))


@pytest.mark.rest
def test_whole_frames_are_taken_against_frames_at_rest(pressed, folder, tmp_path):
    frames = some(replace(pressed, changes=pressed.changes + pressed.unloaded), range(12))
    files = dict(zip(("readings", "presses", "pattern"), frames.write(tmp_path), strict=True))
    rest = tmp_path / "rest.csv"
    noise = 0.01 * np.random.default_rng(0).standard_normal((5, len(pressed.pairs)))
    table(rest, [f"r{k}" for k in range(len(pressed.pairs))], pressed.unloaded + noise)
    done = calibrated(tmp_path, "--rest", rest, sensor=folder / "T.toml", **files)
    printed = json.loads(done.stdout)
    assert printed["registration"]["rotation_deg"] == pytest.approx(25, abs=2)
    with h5py.File(tmp_path / "OUT.h5") as file:
        assert file.attrs["format"] == "cbsr-qa press calibration"
        np.testing.assert_allclose(file["readings/rest"], pressed.unloaded, atol=0.03)
        assert 0.005 < np.median(file["readings/noise"]) < 0.015
    arguments = ["calibration", "apply", tmp_path / "OUT.h5", files["readings"], "--pattern", files["pattern"]]
    own, given = (json.loads(run(*arguments, *rested, "--json").stdout) for rested in ([], ["--rest", rest]))
    assert own["frames"] == given["frames"]


@pytest.mark.rest
def test_a_sensor_type_without_radius_has_it_estimated(pressed, folder, tmp_path):
    sensor = tmp_path / "unsized.toml"
    sensor.write_text('[sensor_type]\nname = "skin"\n[electrodes]\nkind = "pin"\ncount = 16\n')
    files = dict(zip(("readings", "presses", "pattern"), some(pressed, range(20)).write(tmp_path), strict=True))
    done = calibrated(tmp_path, "--differences", sensor=sensor, **files)
    registration = json.loads(done.stdout)["registration"]
    assert registration["scale"] == 1
    assert registration["radius_mm"] == pytest.approx(73, abs=3)
    assert registration["radius_stderr_mm"] > 0


def test_the_file_is_shown_checked_and_converted(folder, tmp_path):
    file = folder / "OUT.h5"
    assert file.stat().st_size < 1e7
    printed = json.loads((folder / "printed.json").read_text())
    shown = json.loads(run("calibration", "show", file, "--json").stdout)
    assert shown["digest"] == printed["digest"]
    assert "no station" in shown["made_by"]
    assert {source["role"] for source in shown["sources"]} == {"readings", "presses", "pattern", "sensor type"}
    assert "no station" in run("calibration", "show", file).output
    assert "is sound" in run("calibration", "verify", file).output
    for source, output in ((file, "as.json"), (tmp_path / "as.json", "again.h5")):
        assert not run("calibration", "export", source, "--output", tmp_path / output).exception
    assert (tmp_path / "again.h5").read_bytes() == file.read_bytes()
    assert "labelled presses" in refused("calibration", "export", file, "--firmware", "--output", tmp_path / "f.json")
    assert "needs --pattern" in refused("calibration", "apply", file, folder / "readings.csv")


def test_a_changed_file_is_refused(folder, tmp_path):
    changed = tmp_path / "changed.h5"
    changed.write_bytes((folder / "OUT.h5").read_bytes()[512:])
    with h5py.File(changed, "r+") as file:
        file["registration/rotation"][()] += 1
    assert "changed after it was issued" in refused("calibration", "verify", changed)


def _doubled(pressed):
    return some(pressed, [*range(60), 7])


def _place(pressed, row, place):
    labels = pressed.labels_mm.copy()
    labels[row] = place
    return replace(pressed, labels_mm=labels)


def _nan(pressed):
    changes = pressed.changes.copy()
    changes[4, 9] = np.nan
    return replace(pressed, changes=changes)


@pytest.mark.parametrize(
    ("spoilt", "labels", "why"),
    [
        (_doubled, {}, "row 61 repeats row 8"),
        (_nan, {}, "readings.csv: row 5, column r9: 'nan'"),
        (lambda p: replace(p, changes=0 * p.changes), {}, "readings.csv: no reading changes in any row"),
        (lambda p: replace(p, changes=1e-300 * p.changes), {}, "and 60 of 60 rows change by so little"),
        (lambda p: replace(p, changes=p.changes[:1] * p.force_N[:, None]), {}, "all rows are proportional"),
        (lambda p: _place(p, 3, np.nan), {}, "presses.csv: row 4, column x_mm: 'nan'"),
        (lambda p: _place(p, 3, (46.0, 0.0)), {}, "row 4, columns x_mm and y_mm: (46, 0) mm"),
        (lambda p: _place(p, slice(None), (46.0, 0.0)), {}, "columns x_mm and y_mm: all 60 presses are at one place"),
        (lambda p: p, {"depth_mm": np.full(60, 2.0)}, "column depth_mm: all 60 rows hold 2"),
        (lambda p: p, {"force_N": np.arange(60.0) - 1}, "row 1, column force_N: -1; a force is positive"),
        (lambda p: p, {"depth": np.arange(60.0)}, "column 'depth' has no unit"),
    ],
)  # fmt: skip
def test_tables_that_cannot_be_used_issue_nothing(pressed, folder, tmp_path, spoilt, labels, why):
    files = dict(zip(("readings", "presses", "pattern"), spoilt(pressed).write(tmp_path, labels=labels), strict=True))
    done = calibrated(tmp_path, "--differences", sensor=folder / "T.toml", **files)
    assert why in str(done.exception)
    assert not (tmp_path / "OUT.h5").exists()


def test_rows_and_columns_that_do_not_match_are_refused(pressed, folder, tmp_path):
    fewer = replace(pressed, labels_mm=pressed.labels_mm[:-1])
    presses = fewer.write(tmp_path / "fewer")[1]
    done = calibrated(folder, "--differences", to="other.h5", presses=presses)
    assert "has 60 rows" in str(done.exception)
    assert "has 59" in str(done.exception)
    pattern = tmp_path / "pairs.csv"
    table(pattern, ["source", "sink", "plus", "minus"], pressed.pairs[1:])
    done = calibrated(folder, "--differences", to="other.h5", pattern=pattern)
    assert "has 192 columns, the pattern has 191 rows" in str(done.exception)


def test_what_the_readings_are_must_be_stated_and_nothing_is_overwritten(folder):
    assert "neither --differences nor --rest" in str(calibrated(folder, to="other.h5").exception)
    both = calibrated(folder, "--differences", "--rest", folder / "readings.csv", to="other.h5")
    assert "both --differences and --rest" in str(both.exception)
    assert "exists already" in str(calibrated(folder, "--differences").exception)


@pytest.fixture(scope="module")
def of_recording(folder, tmp_path_factory):
    """A folder with a calibration learned from a recording of its sensor type, that recording, and its sheet."""
    tmp_path = tmp_path_factory.mktemp("recorded")
    pattern = load_sensor_type(folder / "T.toml").value.pattern
    pairs = np.array([(*pattern.drive[d], *pattern.measure[m]) for d, m in np.argwhere(pattern.usable())])
    sheet = pressed_sheet(24, pairs=pairs, rotation_deg=-60.0)
    rest = np.tile(sheet.unloaded, (3, 1))
    every = {"presses": sheet.changes + sheet.unloaded, "rest": rest}
    every["dead"] = sheet.changes + sheet.unloaded
    every["dead"][::2, (pairs[:, :2] == pattern.drive[5]).all(axis=1)] *= 0.2
    every["both"] = np.concatenate([2 * rest, sheet.changes + 2 * sheet.unloaded])
    for name, values in every.items():
        voltages, flags = np.zeros((len(values), *pattern.shape)), np.zeros((len(values), *pattern.shape), np.uint8)
        voltages[:, pattern.usable()] = 1e-3 * values
        if name == "both":
            flags[5, 0, 4] = ReadingFlag.SATURATED
        frames = FrameBlock(np.arange(len(values), dtype=float), voltages, flags, VoltageUnit.VOLT, 1e-3)
        write_recording(tmp_path / f"{name}.h5", recording(frames))
    labels = sheet.write(tmp_path, labels={"force_N": sheet.force_N})[1]
    files = {"readings": tmp_path / "presses.h5", "presses": labels, "rest": tmp_path / "rest.h5"}
    done = run(
        "calibrate", files["readings"], "--presses", files["presses"], "--sensor-type", folder / "T.toml",
        "--rest", files["rest"], "--to", tmp_path / "OUT.h5", "--json",
    )  # fmt: skip
    assert not done.exception, done.output
    assert json.loads(done.stdout)["registration"]["rotation_deg"] == pytest.approx(-60, abs=2)
    return tmp_path, sheet


@pytest.mark.rest
def test_a_stream_tells_the_places_and_forces_of_apply(of_recording, folder, monkeypatch):
    monkeypatch.setattr("cbsr_qa.app.stream.source.RealClock", VirtualClock)
    learned, _ = of_recording
    for name in ("presses.h5", "dead.h5"):
        applied = json.loads(run("calibration", "apply", learned / "OUT.h5", learned / name, "--json").stdout)
        source = FramesFrom("replayed-recording", {"file": str(learned / name)})
        request = StreamRequest(learned / "OUT.h5", source, sensor_type=str(folder / "T.toml"))
        header, *frames, end = stream_messages(request)
        assert (header.kind, header.force, header.serial, end.why) == ("presses", True, "", "over")
        assert len(frames) == len(applied["frames"])
        for one, told in zip(applied["frames"], frames, strict=True):
            assert list(told.flags) == one["flags"]
            if told.touch:
                assert (told.x_mm, told.y_mm) == pytest.approx((one["x_mm"], one["y_mm"]), abs=1e-6)
                radius_mm = np.sqrt(applied["q95"] * np.linalg.eigvalsh(one["covariance_mm2"])[-1])
                assert told.radius_95_mm == pytest.approx(radius_mm, rel=1e-6)
                assert told.force_N == pytest.approx(one["force_N"], rel=1e-6)
                assert told.force_95_N == pytest.approx(tuple(one["force_95_N"]), rel=1e-6)


def test_python_tells_the_places_and_forces_of_apply(of_recording):
    folder, _ = of_recording
    applied = json.loads(run("calibration", "apply", folder / "OUT.h5", folder / "dead.h5", "--json").stdout)
    estimator = load_calibration(folder / "OUT.h5")
    frames = read_recording_file(folder / "dead.h5", discover(), format_=None, dataset=None).frames
    touches = estimator.estimate(frames.voltages)
    assert (estimator.regions.q68, estimator.regions.q95) == (applied["q68"], applied["q95"])
    for number, one in enumerate(applied["frames"]):
        assert touches.place_mm[number].tolist() == [one["x_mm"], one["y_mm"]]
        assert touches.covariance_mm2[number].tolist() == one["covariance_mm2"]
        assert touches.force.values[number] == one["force_N"]
        assert touches.force.within_95[number].tolist() == one["force_95_N"]
        assert flag_names(int(touches.flags[number])) == tuple(one["flags"])
    assert touches.depth is None
    assert estimator.lacks["depth"] == "was learned from presses that had no depth"
    masked = np.ma.array(frames.voltages[1])
    masked[0, 5] = np.ma.masked
    assert "missing" in flag_names(int(estimator.estimate(masked).flags[0]))
    with pytest.raises(CalibrationError, match=r"frames of shape \(3, 3\) are not of this calibration"):
        estimator.estimate(np.zeros((3, 3)))


def test_a_recording_of_the_sensor_type_is_turned_into_places(of_recording):
    folder, sheet = of_recording
    done = run("calibration", "apply", folder / "OUT.h5", folder / "presses.h5", "--json")
    frames = json.loads(done.stdout)["frames"]
    found = np.array([(frame["x_mm"], frame["y_mm"]) for frame in frames])
    assert np.linalg.norm(found - sheet.labels_mm, axis=1).mean() < 4
    assert not any({"dead_pair", "open_electrode", "saturated"} & set(frame["flags"]) for frame in frames)
    done = run("calibration", "apply", folder / "OUT.h5", folder / "dead.h5", "--json")
    dead = json.loads(done.stdout)["frames"]
    assert all("dead_pair" in frame["flags"] and "missing" not in frame["flags"] for frame in dead[::2])
    beside = [(frame["x_mm"], frame["y_mm"]) for frame in dead[::2]]
    assert np.linalg.norm(beside - sheet.labels_mm[::2], axis=1).mean() < 4
    assert [frame["x_mm"] for frame in dead[1::2]] == [frame["x_mm"] for frame in frames[1::2]]
    # Against its own first frames, and with a reading flagged in the third press.
    done = run("calibration", "apply", folder / "OUT.h5", folder / "both.h5", "--reference", "3", "--json")
    again = json.loads(done.stdout)["frames"]
    assert len(again) == 27
    assert "not_detected" in again[0]["flags"]
    assert "missing" in again[5]["flags"]
    found = np.array([(frame["x_mm"], frame["y_mm"]) for frame in again[3:]])
    assert np.linalg.norm(found - sheet.labels_mm, axis=1).mean() < 4


def test_a_recording_that_cannot_be_turned_into_places_is_refused(of_recording, folder, pressed):
    recorded, _ = of_recording
    apply = ("calibration", "apply")
    # Calibrated from a table of other pairs than those of the sensor type's frames.
    assert "192 of the 192 readings" in refused(*apply, folder / "OUT.h5", recorded / "presses.h5", "--differences")
    assert "--reference 28 of both.h5; it holds 27 frames" in refused(
        *apply, recorded / "OUT.h5", recorded / "both.h5", "--reference", "28"
    )
    assert "a reading of the first 6 frames of both.h5 is missing or saturated" in refused(
        *apply, recorded / "OUT.h5", recorded / "both.h5", "--reference", "6"
    )
    for option, why in (
        (("--serial", "S-1"), "states no serial number"),
        (("--place", 0, 0), "finds the places itself"),
    ):
        assert why in refused(*apply, recorded / "OUT.h5", recorded / "both.h5", *option)
    other = recorded / "of-another-type.h5"
    pressed_frames = read_recording_file(recorded / "presses.h5", discover(), format_=None, dataset=None)
    write_recording(other, replace(pressed_frames, path=other, sensor_type="strip"))
    assert "of-another-type.h5 is of sensor type strip, the calibration is of a" in refused(
        *apply, recorded / "OUT.h5", other
    )
    few = Path(recorded / "few.h5")
    block = FrameBlock(np.zeros(1), np.ones((1, 16, 4)), np.zeros((1, 16, 4), np.uint8), VoltageUnit.VOLT, 1e-3)
    write_recording(few, recording(block))
    sensor_type, rest = ("--sensor-type", folder / "T.toml"), ("--rest", recorded / "rest.h5")
    presses = ("--presses", recorded / "presses.csv")
    assert "16 × 4 readings" in refused("calibrate", few, *presses, *sensor_type, *rest, "--to", recorded / "X.h5")


def test_a_pair_that_is_missing_when_it_is_applied_is_named(pressed, folder, tmp_path):
    fewer = replace(pressed, pairs=pressed.pairs[1:], changes=pressed.changes[:, 1:])
    readings_file, _, pattern = fewer.write(tmp_path)
    why = refused("calibration", "apply", folder / "OUT.h5", readings_file, "--pattern", pattern, "--differences")
    assert "1 of the 192 readings" in why


@pytest.mark.rest
def test_a_sheet_that_is_not_modelled_is_learned_from_its_presses_alone(folder, tmp_path):
    pressed = pressed_sheet(20, pairs=adjacent_pairs())
    random = np.random.default_rng(0)
    places = np.column_stack([pressed.places_mm, pressed.places_mm**2 / 40, np.ones(20)])
    strange = replace(pressed, changes=places @ random.standard_normal((5, len(pressed.pairs))))
    files = dict(zip(("readings", "presses", "pattern"), strange.write(tmp_path), strict=True))
    printed = json.loads(calibrated(tmp_path, "--differences", sensor=folder / "T.toml", **files).stdout)
    assert not printed["registration"]["trusted"]
    assert any("not what the sensor type describes" in words for words in printed["warnings"])


@pytest.mark.rest
def test_places_one_row_below_their_readings_are_suspected_and_shifted_back_only_if_asked(folder, pressed, tmp_path):
    header, *rows = (folder / "presses.csv").read_text().splitlines()
    (tmp_path / "late.csv").write_text("\n".join([header, rows[-1], *rows[:-1]]) + "\n")
    late = calibrated(folder, "--differences", to=tmp_path / "late.h5", presses=tmp_path / "late.csv")
    assert late.return_value == 1
    printed = json.loads(late.stdout)
    assert printed["place_learned"] is False
    assert "places stand 1 row below their readings (give --row-shift 1)" in printed["labels"]["suspected"]
    assert printed["labels"]["gain_mm"] > 10
    assert printed["labels"]["suspected"] == printed["warnings"][0]
    files = {"presses": tmp_path / "late.csv"}
    shifted = calibrated(folder, "--differences", "--row-shift", "1", to=tmp_path / "shifted.h5", **files)
    assert shifted.return_value == 0
    assert (json.loads(shifted.stdout)["used"], json.loads(shifted.stdout)["labels"]["suspected"]) == (59, None)
    assert "a shift by 60 rows leaves none" in refused(
        "calibrate", folder / "readings.csv", "--presses", tmp_path / "late.csv", "--pattern", folder / "pairs.csv",
        "--sensor-type", folder / "T.toml", "--to", tmp_path / "x.h5", "--differences", "--row-shift", "60",
    )  # fmt: skip


@pytest.mark.rest
def test_exchanged_electrodes_are_a_warning(folder, tmp_path):
    wired = np.arange(16)
    wired[[2, 9]] = 9, 2
    files = dict(zip(("readings", "presses", "pattern"), pressed_sheet(20, wired=wired).write(tmp_path), strict=True))
    printed = json.loads(calibrated(tmp_path, "--differences", sensor=folder / "T.toml", **files).stdout)
    assert any("electrodes 2 and 9 seem to be exchanged" in words for words in printed["warnings"])
