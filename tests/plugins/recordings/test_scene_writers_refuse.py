"""Scenes that a format cannot hold are refused, with what helps, and nothing is written."""

from dataclasses import replace

import numpy as np
import pytest
from written_scenes import FORMATS, INNER, LAB, made_up, middles_s, setting, volts

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.world import Dump, Transcript
from cbsr_qa.domain.readings.frames import ReadingFlag, ReadOptions, ScanKind, VoltageUnit
from cbsr_qa.domain.sensor.patterns import DrivePattern, adjacent_pattern, list_pairs
from cbsr_qa_plugins.recordings.cbsr_recording import CbsrRecording
from cbsr_qa_plugins.recordings.smu_rig_csv import SmuRigCsv


def _of(**changes):
    """A transcript of another sensor type."""
    sensor_type = replace(setting().sensor_type, **changes)
    return Transcript.complete(replace(setting(), sensor_type=sensor_type), middles_s(4))


def _other_pattern():
    return _of(pattern=DrivePattern(16, list_pairs("adjacent", 16), list_pairs("skip-1", 16)))


def _eight():
    return _of(electrodes=replace(setting().sensor_type.electrodes, count=8), pattern=adjacent_pattern(8))


def _lost(count):
    return made_up(4, lost=[(k, 0, 1) for k in range(count)])[1]


def _frames(**changes):
    recording, _ = made_up(4)
    return replace(recording, frames=replace(recording.frames, **changes))


def _flagged():
    flags = np.zeros((4, 16, 16), np.uint8)
    flags[2, 3, 5] = ReadingFlag.MISSING
    return flags


REFUSED = {
    "counts": (lambda: _frames(unit=VoltageUnit.COUNT), None, "counts", "cbsr-recording"),
    "still": (lambda: replace(made_up(4)[0], still=True), None, "still images", "cbsr-recording"),
    "magnitudes": (lambda: replace(made_up(4)[0], magnitudes_only=True), None, "magnitudes", "cbsr-recording"),
    "one row": (lambda: replace(made_up(4)[0], scan=ScanKind.DRIVEN_PAIRS), None, "driven pairs", "cbsr-recording"),
    "pattern": (lambda: made_up(4)[0], _other_pattern, "adjacent pattern of 16", "electrodes with the adjacent"),
    "electrodes": (lambda: made_up(4)[0], _eight, "8 pairs of 8", "electrodes with the adjacent"),
    "other transcript": (lambda: made_up(4)[0], lambda: made_up(5)[1], "transcript of 5 frames", "all frames"),
    "missing": (lambda: _frames(flags=_flagged()), None, "frame 2 (drive pair 3, measure pair 5)", "cbsr-recording"),
    "half lost": (lambda: made_up(4)[0], lambda: _lost(2), "2 of 4 frames lose rows", "fewer than half"),
    "times": (lambda: _frames(time_s=middles_s(4)[::-1].copy()), None, "fall", "time-skew"),
}  # fmt: skip


@pytest.mark.parametrize("name", LAB)
@pytest.mark.parametrize("case", REFUSED)
def test_what_a_lab_rig_cannot_have_recorded_is_refused(tmp_path, name, case):
    recording, transcript, reason, remedy = REFUSED[case]
    with pytest.raises(RefusedError) as said:
        FORMATS[name]().write(tmp_path / "x.csv", recording(), made_up(4)[1] if transcript is None else transcript())
    assert reason in said.value.reason
    assert remedy in said.value.remedy
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", LAB)
def test_readings_in_the_other_rigs_order_are_refused(tmp_path, name):
    other = {"measure": "drive", "drive": "measure"}[INNER[name]]
    with pytest.raises(RefusedError, match="steps faster") as said:
        FORMATS[name]().write(tmp_path / "x.csv", *made_up(4, inner=other, dumps=[Dump(1, 2, 0.075)]))
    assert f'inner = "{INNER[name]}"' in said.value.remedy
    assert ("watchdog-dump" in said.value.remedy) == (name == "smu-rig-csv")


@pytest.mark.parametrize("name", FORMATS)
def test_no_file_is_written_over(tmp_path, name):
    path = tmp_path / "x.csv"
    path.write_text("mine")
    with pytest.raises(RefusedError, match="exists already"):
        FORMATS[name]().write(path, *made_up(4))
    assert path.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", FORMATS)
def test_a_folder_that_cannot_be_made_is_refused_by_name(tmp_path, name):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(RefusedError, match="cannot be written"):
        FORMATS[name]().write(tmp_path / "file" / "x.csv", *made_up(4))


def test_our_own_format_needs_a_whole_frame_and_its_own_transcript(tmp_path):
    for transcript in (_lost(4), made_up(5)[1]):
        with pytest.raises(RefusedError):
            CbsrRecording().write(tmp_path / "x.h5", made_up(4)[0], transcript)
    assert list(tmp_path.iterdir()) == []


def test_numbers_a_lab_file_cannot_hold_are_refused(tmp_path):
    _, transcript = made_up(4)
    large = _frames(voltages=1e4 * volts(4))
    silent = _frames(voltages=np.zeros((4, 16, 16)))
    years = _frames(time_s=1e7 * np.arange(4))
    unknown = _frames(current_A=None)
    for name, refused, kept, reason in (
        ("smu-rig-csv", large, transcript, "V at"),
        ("smu-rig-csv", unknown, _lost(1), "states none"),
        ("ert-board-csv", silent, transcript, "no scale"),
        ("ert-board-csv", years, transcript, "clock counts up to"),
    ):
        with pytest.raises(RefusedError, match=reason):
            FORMATS[name]().write(tmp_path / "x.csv", refused, kept)
    assert list(tmp_path.iterdir()) == []
    SmuRigCsv().write(tmp_path / "x.csv", unknown, transcript)
    assert SmuRigCsv().read(tmp_path / "x.csv", ReadOptions()).frames.current_A is None
