"""``cbsr-qa analyse`` from the command line, on files made here."""

import json
from pathlib import Path

import numpy as np
import pytest
from board_files import BoardFile

from cbsr_qa.analysis.recording_file import write_recording
from cbsr_qa.analysis.recording_imaging import nominal_disc
from cbsr_qa.cli.main import guarded
from cbsr_qa.domain.frames import FrameBlock, SampleBlock, VoltageUnit
from cbsr_qa.domain.recording import Recording, ScanKind
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.forward.coverage import disc_coverage
from cbsr_qa.reconstruct.problem import nominal_model

DISC: SensorType = nominal_disc(None, 16)


def pressed_frames(x, y, *, contrast, n=80, start=30, end=60, seed=1):
    """Volts of a disc with one press, by the forward model; (n, 16, 16)."""
    model = nominal_model(DISC)
    empty = model.model.voltages()
    elements, share = disc_coverage(model.model.mesh, 50 * x, 50 * y, 6.5)
    full = model.voltages(elements, contrast * share)
    loaded = np.zeros(n)
    loaded[start:end] = 1
    noise = np.random.default_rng(seed).normal(0, 1e-4 * np.abs(empty).mean(), (n, 16, 16))
    return empty + loaded[:, None, None] * (full - empty) + noise


@pytest.fixture(autouse=True)
def own_var(tmp_path, monkeypatch):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))


def run(capsys, *arguments):
    code = guarded(["analyse", *map(str, arguments)])
    said = capsys.readouterr()
    return code, said.out, said.err


def exported(tmp_path, frames, *, sensor_type=None, name="run.h5"):
    times = 100 + 2.5 * np.arange(len(frames))
    block = FrameBlock(times, frames, np.zeros(frames.shape, np.uint8), VoltageUnit.VOLT, 0.001)
    force = SampleBlock("force", "N", times, np.where((times > 175) & (times < 250), 4.0, 0.0))
    path = tmp_path / name
    recording = Recording(
        path, "cbsr-recording", "", ScanKind.FULL, block, None, False, False, "computer", (force,),
        sensor_type=sensor_type,
    )  # fmt: skip
    write_recording(path, recording)
    return path


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
    code, out, _ = run(capsys, path, "--json", "--sensor-type", "disc-99mm")
    assert code == 2
    assert "disc-99mm" in json.loads(out)["refused"]["reason"]


def test_words_and_json_say_the_same_and_progress_goes_to_stderr(tmp_path, capsys):
    path = exported(tmp_path, pressed_frames(0.4, 0.3, contrast=-0.1))
    code, out, err = run(capsys, path)
    assert code == 0
    assert "conducts less" in out
    assert "80 frames" in out
    assert "analysing" in err
    assert "analysing" not in out


def test_a_reference_recording_turns_presses_into_objects(tmp_path, capsys):
    empty = exported(tmp_path, pressed_frames(0.4, 0.3, contrast=0.0, seed=2), name="empty.h5")
    held = exported(tmp_path, pressed_frames(-0.3, 0.5, contrast=0.2, start=10, end=70), name="held.h5")
    found = json.loads(run(capsys, held, "--json", "--no-report", "--reference", empty)[1])
    (event,) = found["events"]
    assert (event["x_over_R"], event["y_over_R"]) == pytest.approx((-0.3, 0.5), abs=0.05)
    assert (event["start_s"], event["end_s"]) == pytest.approx((25.0, 172.5))


def test_several_files_give_one_document_and_the_worst_exit_code(tmp_path, capsys):
    good = exported(tmp_path, pressed_frames(0.4, 0.3, contrast=-0.1))
    bad = BoardFile().header().save(tmp_path)
    code, out, err = run(capsys, good, bad, "--json", "--no-report")
    documents = json.loads(out)["files"]
    assert code == 2
    assert [("refused" in document) for document in documents] == [False, True]
    assert "only headers" in err


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty"),
        (b"   \n\n", "is empty"),
        (b"hello, world\n1,2,3\n", "in no format that is known here"),
        (b"\x89HDF\r\n\x1a\n" + bytes(200), "damaged"),
        (b"MATLAB 5.0 MAT-file" + bytes(200), "cannot be read"),
        (b"time_pc [s],voltage [V],i_src [A],f [N],x [mm],y [mm],z [mm]\n", "only headers"),
        (b"#MEAS\n#Vector, Vr Vi I\n", "#Start"),
    ],
)
def test_bad_files_are_refused_clearly_and_nothing_is_written(tmp_path, capsys, content, said):
    path = tmp_path / "odd.dat"
    path.write_bytes(content)
    code, out, _ = run(capsys, path, "--json")
    assert code == 2
    assert said in json.loads(out)["refused"]["reason"]
    assert not (tmp_path / "var").exists()


def test_a_missing_file_a_folder_and_an_unknown_format_are_refused(tmp_path, capsys):
    for arguments, said in (
        ((tmp_path / "none.csv",), "there is no file"),
        ((tmp_path,), "is not a file"),
        ((BoardFile().header().save(tmp_path), "--format", "ert-board"), "no recording plugin named"),
    ):
        code, out, _ = run(capsys, *arguments, "--json")
        assert code == 2
        assert said in json.loads(out)["refused"]["reason"]


def test_quiet_recordings_end_with_no_event_and_its_reason(tmp_path, capsys):
    path = exported(tmp_path, pressed_frames(0, 0, contrast=0.0))
    code, out, _ = run(capsys, path)
    assert code == 0
    assert "no event" in out
    assert "nothing stands out" in out


def test_noise_free_frames_that_never_change_are_no_event(tmp_path, capsys):
    still = np.repeat(pressed_frames(0, 0, contrast=0.0)[:1], 20, axis=0)
    code, out, _ = run(capsys, exported(tmp_path, still), "--json", "--no-report")
    assert code == 0
    assert json.loads(out)["events"] == []


def test_the_hostile_text_of_a_file_name_stays_text_in_the_report(tmp_path, capsys):
    path = exported(tmp_path, pressed_frames(0, 0, contrast=0.0), name="<script>alert(1)<script>.h5")
    found = json.loads(run(capsys, path, "--json")[1])
    html = Path(found["report"]).read_text(encoding="utf-8")
    assert "<script>" not in html
    assert "&lt;script&gt;" in html
