"""``cbsr-qa analyse`` from the command line, on files made here."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from board_files import BoardFile, counts
from pressed_files import exported, pressed_frames

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.readings.frames import ScanKind, VoltageUnit


@pytest.fixture(autouse=True)
def own_var(tmp_path, monkeypatch):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))


def run(capsys, *arguments):
    code = run_guarded(["analyse", *map(str, arguments)])
    said = capsys.readouterr()
    return code, said.out, said.err


def refused(capsys, *arguments):
    """Return the document of a file that is refused."""
    code, out, _ = run(capsys, *arguments, "--json")
    assert code == 2
    return json.loads(out)


def test_a_press_in_an_export_is_found_with_force_and_reported(tmp_path, capsys):
    path = exported(tmp_path, pressed_frames(0.4, 0.3, contrast=-0.1))
    code, out, _ = run(capsys, path, "--json")
    found = json.loads(out)
    assert code == 0
    (event,) = found["events"]
    assert (event["x_over_R"], event["y_over_R"]) == pytest.approx((0.4, 0.3), abs=0.05)
    assert event["electrode"] == pytest.approx(np.arctan2(0.3, 0.4) * 16 / (2 * np.pi), abs=0.2)
    assert event["start_s"] == pytest.approx(73.75, abs=1.5)
    assert event["end_s"] == pytest.approx(148.75, abs=1.5)
    assert (event["sign"], event["force_N"]) == (-1, 4.0)
    assert "x_mm" not in event
    assert found["recording"]["frame_rate_hz"] == pytest.approx(0.4)
    report = (tmp_path / "var" / "reports").glob("*.html")
    assert [str(p) for p in report] == [found["report"]]
    assert "1 event" in Path(found["report"]).read_text(encoding="utf-8")


def test_a_recording_with_every_pair_at_its_ceiling_is_refused_as_saturated(tmp_path, capsys):
    rows = 3000 + np.random.default_rng(5).integers(-4, 5, (60, 1, 16))
    path = BoardFile(mass=False).header().frames(rows).save(tmp_path)
    assert "saturated: all 16 readings" in refused(capsys, path)["refused"]["reason"]


@pytest.mark.rest
def test_a_named_sensor_type_gives_millimetres(tmp_path, capsys):
    path = exported(tmp_path, pressed_frames(0.4, 0.3, contrast=0.1), sensor_type="disc-100mm")
    stated = json.loads(run(capsys, path, "--json", "--no-report")[1])["events"][0]
    named = json.loads(run(capsys, path, "--json", "--no-report", "--sensor-type", "disc-150mm")[1])["events"][0]
    assert (stated["x_mm"], stated["y_mm"]) == pytest.approx((50 * stated["x_over_R"], 50 * stated["y_over_R"]))
    assert named["x_mm"] == pytest.approx(75 * named["x_over_R"])
    assert stated["sign"] == 1


def test_an_unknown_stated_sensor_type_is_a_warning_an_unknown_named_one_a_refusal(tmp_path, capsys):
    path = exported(tmp_path, pressed_frames(0.4, 0.3, contrast=0.1), sensor_type="no-such-type")
    found = json.loads(run(capsys, path, "--json", "--no-report")[1])
    assert any("no-such-type" in warning for warning in found["warnings"])
    assert "x_mm" not in found["events"][0]
    assert "disc-99mm" in refused(capsys, path, "--sensor-type", "disc-99mm")["refused"]["reason"]


@pytest.mark.rest
def test_words_and_json_say_the_same_and_progress_goes_to_stderr(tmp_path, capsys):
    path = exported(tmp_path, pressed_frames(0.4, 0.3, contrast=-0.1))
    code, out, err = run(capsys, path)
    assert code == 0
    assert "conducts less" in out
    assert re.search(r"frames +80\n", out)
    assert "analysing" in err
    assert "analysing" not in out


def test_a_reference_recording_turns_presses_into_objects(tmp_path, capsys):
    empty = exported(tmp_path, pressed_frames(0.4, 0.3, contrast=0.0, seed=2), name="empty.h5")
    held = exported(tmp_path, pressed_frames(-0.3, 0.5, contrast=0.2, start=10, end=70), name="held.h5")
    found = json.loads(run(capsys, held, "--json", "--no-report", "--reference", empty)[1])
    (event,) = found["events"]
    assert (event["x_over_R"], event["y_over_R"]) == pytest.approx((-0.3, 0.5), abs=0.05)
    assert (event["start_s"], event["end_s"]) == pytest.approx((25.0, 172.5))


@pytest.mark.rest
def test_a_rounded_zero_has_no_sign_and_one_frame_is_one(tmp_path, capsys):
    path = exported(tmp_path, pressed_frames(-4e-4, 0.5, contrast=-0.1), sensor_type="disc-100mm")
    out = run(capsys, path, "--no-report")[1]
    (x_mm,) = re.findall(r"E1 .*electrode \S+ r/R \S+ +(\S+) ", out)
    (event,) = json.loads(run(capsys, path, "--no-report", "--json")[1])["events"]
    assert -0.05 < event["x_mm"] < 0
    assert x_mm == "0.0"
    tank = tmp_path / "tank.mat"
    frames = np.abs(pressed_frames(0.4, 0.3, contrast=0.3, n=2, start=1, end=2))
    scipy.io.savemat(tank, {"vv": frames[1:].reshape(1, 256).T, "vvRef": frames[:1].reshape(1, 256).T})
    out = run(capsys, tank, "--dataset", "vv", "--reference", f"{tank}:vvRef", "--no-report")[1]
    for fact in ("data set +vv", "frames +1", "frame rate +none: still images"):
        assert re.search(rf"^{fact}$", out, re.M)


def test_a_refusal_names_its_file_once(tmp_path, capsys):
    headers = BoardFile().header().save(tmp_path)
    assert run(capsys, headers)[2].count(headers.name) == 2  # once as it is read
    path = exported(tmp_path, pressed_frames(0, 0, contrast=0.0, n=6))
    code, _, err = run(capsys, path, "--reconstruction", "no-such")
    assert code == 2
    assert err.startswith("cbsr-qa: --reconstruction: ")
    assert path.name not in err  # the file is not at fault


@pytest.mark.rest
def test_what_was_simulated_is_said_wherever_results_are(tmp_path, capsys):
    path = exported(tmp_path, pressed_frames(0, 0, contrast=0.0, n=12), simulated=("sheet: a <bench>, seed 7",))
    assert "  sheet: a <bench>, seed 7\n" in run(capsys, path, "--no-report")[1]
    found = json.loads(run(capsys, path, "--json")[1])
    html = Path(found["report"]).read_text(encoding="utf-8")
    head, _, foot = html.partition("</header>")
    assert found["recording"]["simulated"] == ["sheet: a <bench>, seed 7"]
    assert "This report does not describe a real sensor" in head
    assert "<li>sheet: a &lt;bench&gt;, seed 7</li>" in head
    assert "· simulated</footer>" in foot
    measured = exported(tmp_path, pressed_frames(0, 0, contrast=0.0, n=12, seed=2), name="measured.h5")
    assert "simulated" not in run(capsys, measured, "--no-report")[1]
    found = json.loads(run(capsys, measured, "--json", "--reference", path)[1])
    assert found["recording"]["simulated"] == ["in the reference run.h5: sheet: a <bench>, seed 7"]


def test_several_files_give_one_document_and_the_worst_exit_code(tmp_path, capsys):
    good = exported(tmp_path, pressed_frames(0.4, 0.3, contrast=-0.1))
    bad = BoardFile().header().save(tmp_path)
    code, out, err = run(capsys, good, bad, "--json", "--no-report")
    documents = json.loads(out)["files"]
    assert code == 2
    assert [("refused" in document) for document in documents] == [False, True]
    assert "only headers" in err


def in_bytes(board):
    return "\n".join(board.lines).encode()


SMU_RIG = b"time_pc [s],voltage [V],i_src [A],f [N],x [mm],y [mm],z [mm]\n"
#: What a file holds, why it is refused, its format and how many of its rows are rejected.
BAD_FILES = {
    "nothing": (b"", "is empty", None, 0),
    "blanks": (b"   \n\n", "is empty", None, 0),
    "text": (b"hello, world\n1,2,3\n", "has no known format", None, 0),
    "HDF5 cut off": (b"\x89HDF\r\n\x1a\n" + bytes(200), "damaged", "cbsr-recording", 0),
    "MATLAB cut off": (b"MATLAB 5.0 MAT-file" + bytes(200), "cannot be read", "eidors-mat", 0),
    "headers of the board": (in_bytes(BoardFile().header()) + b"\n", "only headers", "ert-board-csv", 0),
    "a row cut off": (in_bytes(BoardFile().header().mark().rows(counts(1)[0, :5]))[:-3], "", "ert-board-csv", 1),
    "headers of the rig": (SMU_RIG, "only headers", "smu-rig-csv", 0),
    "no number": (SMU_RIG + b"0.1,nan,nan,0,0,0,0\n", "", "smu-rig-csv", 1),
    "headers of the tank": (b"#MEAS\n#Vector, Vr Vi I\n", "#Start", "ds-tank-text", 0),
    "a row too short": (b"#MEAS\n#Vector, Vr Vi I\n#Start\n1 2\n", "", "ds-tank-text", 1),
}  # fmt: skip


@pytest.mark.parametrize(("content", "said", "format_", "rejected"), BAD_FILES.values(), ids=BAD_FILES)
def test_bad_files_are_refused_clearly_and_nothing_is_written(tmp_path, capsys, content, said, format_, rejected):
    path = tmp_path / "odd.dat"
    path.write_bytes(content)
    found = refused(capsys, path)
    assert said in found["refused"]["reason"]
    assert not (tmp_path / "var").exists()
    read = found["recording"]
    assert (read["format"], read["frames"], read["rows_rejected"]) == (format_, 0, rejected)
    assert sum(problem["rejected"] for problem in read["problems"]) == rejected
    assert (read["frame_rate_hz"], read["force_recorded"]) == (None, None)
    assert (found["channels"], found["events"]) == ({}, [])


def test_a_refused_document_has_all_keys_of_an_analysed_one(tmp_path, capsys):
    analysed = json.loads(run(capsys, exported(tmp_path, pressed_frames(0, 0, contrast=0.0)), "--json")[1])
    for content, *_ in BAD_FILES.values():
        (tmp_path / "odd.dat").write_bytes(content)
        assert set(refused(capsys, tmp_path / "odd.dat")["recording"]) == set(analysed["recording"])


def test_a_missing_file_a_folder_and_an_unknown_format_are_refused(tmp_path, capsys):
    for arguments, said in (
        ((tmp_path / "none.csv",), "there is no file"),
        ((tmp_path,), "it is a folder, not a file"),
        ((BoardFile().header().save(tmp_path), "--format", "ert-board"), "no recording plugin named"),
    ):
        assert said in refused(capsys, *arguments)["refused"]["reason"]


def test_quiet_recordings_end_with_no_event_and_its_reason(tmp_path, capsys):
    path = exported(tmp_path, pressed_frames(0, 0, contrast=0.0))
    code, out, _ = run(capsys, path)
    assert code == 0
    assert "no event" in out
    assert "nothing stands out" in out


def board(tmp_path, frames, name="board.csv"):
    return BoardFile().header().frames(np.round(frames).astype(int)).save(tmp_path, name)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"unit": VoltageUnit.COUNT}, "in count, not in V"),
        ({"magnitudes_only": True}, "absolute values"),
        ({"current_A": 0.0013}, "drive current"),
        ({"sensor_type": "disc-150mm"}, "sensor type disc-150mm"),
        ({"scale": 2.0}, "2 times as large"),
        ({"scale": 0.5}, "0.5 times as large"),
        ({"turned": 1}, "another pattern"),
        ({"scan": ScanKind.DRIVEN_PAIRS}, "one row of driven pairs"),
    ],
)
def test_a_reference_of_another_instrument_or_scale_is_refused(tmp_path, capsys, change, said):
    frames = pressed_frames(0.4, 0.3, contrast=0.0, seed=2)
    frames = np.roll(frames, change.get("turned", 0), axis=2) * change.get("scale", 1.0)
    if "scan" in change:
        frames = frames[:, :1]
    options = {key: value for key, value in change.items() if key not in ("scale", "turned")}
    empty = exported(tmp_path, frames, name="empty.h5", **{"sensor_type": "disc-100mm", **options})
    held = exported(
        tmp_path, pressed_frames(-0.3, 0.5, contrast=0.2, start=10, end=70), name="held.h5", sensor_type="disc-100mm"
    )
    found = refused(capsys, held, "--no-report", "--reference", empty)
    assert said in found["refused"]["reason"]
    assert "empty.h5" in found["refused"]["reason"]
    assert "held.h5" in found["refused"]["reason"]
    assert found["refused"]["remedy"]
    assert found["events"] == []
    assert found["recording"]["frames"] == 80


@pytest.mark.parametrize(("level", "unit"), [(0.0, VoltageUnit.VOLT), (32534.0, VoltageUnit.COUNT)])
def test_a_reference_of_an_unconnected_instrument_is_refused(tmp_path, capsys, level, unit):
    frames = pressed_frames(0.4, 0.3, contrast=0.0, n=6)
    held = exported(tmp_path, frames, name="held.h5", unit=unit)
    empty = exported(tmp_path, np.full_like(frames, level), name="empty.h5", unit=unit)
    reason = refused(capsys, held, "--reference", empty)["refused"]["reason"]
    assert reason.startswith("empty.h5 cannot be the reference of held.h5")
    assert f"all its readings are {level:.4g} {unit.value}" in reason
    assert not (tmp_path / "var").exists()


def test_counts_about_another_offset_are_no_reference(tmp_path, capsys):
    frames = 1e4 * pressed_frames(0.4, 0.3, contrast=0.0, n=6)
    held, empty = board(tmp_path, frames + 100), board(tmp_path, frames + 8000, "empty.csv")
    assert "lie about" in refused(capsys, held, "--no-report", "--reference", empty)["refused"]["reason"]


def test_a_reference_is_recognised_by_itself(tmp_path, capsys):
    """Whatever the file's own format is, and whether it was named."""
    tank = tmp_path / "tank.mat"
    frames = np.abs(pressed_frames(0.4, 0.3, contrast=0.0, n=2))
    scipy.io.savemat(tank, {"vv": frames[1:].reshape(1, 256).T, "vvRef": frames[:1].reshape(1, 256).T})
    csv = board(tmp_path, 1e4 * frames)
    for arguments in ((tank, "--dataset", "vv"), (tank, "--dataset", "vv", "--format", "eidors-mat")):
        reason = refused(capsys, *arguments, "--reference", csv, "--no-report")["refused"]["reason"]
        assert "board.csv cannot be the reference of tank.mat" in reason
        assert "damaged" not in reason
    code, out, _ = run(capsys, tank, "--dataset", "vv", "--reference", f"{tank}:vvRef", "--json", "--no-report")
    assert code == 0
    assert any("changes are against tank.mat:vvRef" in note for note in json.loads(out)["recording"]["notes"])


def test_an_unreadable_reference_is_named_as_the_reference(tmp_path, capsys):
    held = exported(tmp_path, pressed_frames(0.4, 0.3, contrast=0.1))
    for other, said in (
        (BoardFile().header().save(tmp_path), "only headers"),
        (tmp_path / "no.csv", "there is no file"),
    ):
        reason = refused(capsys, held, "--no-report", "--reference", other)["refused"]["reason"]
        assert said in reason
        assert other.name in reason


@pytest.mark.parametrize("text", ["", " ", ":"])
def test_an_empty_reference_is_a_misused_option(tmp_path, capsys, text):
    code, out, _ = run(capsys, exported(tmp_path, pressed_frames(0, 0, contrast=0.0)), "--json", "--reference", text)
    assert code == 2
    assert "--reference" in json.loads(out)["refused"]["reason"]


def test_a_current_that_is_none_is_valid_json(tmp_path, capsys):
    file = BoardFile(mass=False).header().frames(counts(4))
    file.lines[1] = "Isrc:,nan"
    code, out, _ = run(capsys, file.save(tmp_path), "--json", "--no-report")
    assert code in (0, 2)
    assert json.loads(out)["recording"]["current_A"] is None


@pytest.mark.rest
def test_reports_of_different_questions_do_not_overwrite_each_other(tmp_path, capsys):
    path = exported(tmp_path, pressed_frames(0, 0, contrast=0.0, n=12))
    empty = exported(tmp_path, pressed_frames(0, 0, contrast=0.0, n=12, seed=3), name="empty.h5")
    asked = ((), ("--sensor-type", "disc-100mm"), ("--reference", empty), ("--no-memory-correction",), ())
    names = [json.loads(run(capsys, path, "--json", *more)[1])["report"] for more in asked]
    assert len(set(names)) == 4
    assert names[0] == names[-1]
