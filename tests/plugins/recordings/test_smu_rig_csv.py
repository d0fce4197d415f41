"""The SMU rig's per-reading CSV, from its description alone: no recording of it is at hand."""

import numpy as np
import pytest

from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.readings.carry_over import scan_order
from cbsr_qa.domain.readings.frames import ReadingFlag, ReadOptions, VoltageUnit
from cbsr_qa_plugins.recordings.lab_files import MOST_BAD_IN_A_ROW
from cbsr_qa_plugins.recordings.smu_rig_csv import SmuRigCsv

TITLES = "time_pc [s],voltage [V],i_src [A],f [N],x [mm],y [mm],z [mm]"
HEADER = ["UTC:,2023-05-02 11:00:00.000000", TITLES]


def frames(count=4, seed=3):
    voltages = np.random.default_rng(seed).normal(0, 0.1, (count, 16, 16))
    voltages[:, np.arange(16), np.arange(16)] += 15.0
    return voltages


def lines_of(voltages, *, first_s=0.1, force_sign=1.0):
    """Current pair inner: the measure pair changes every 16 lines, and i_src is read once per 16."""
    stream = voltages.swapaxes(1, 2).ravel()
    out = []
    for k, value in enumerate(stream):
        current = "0.0009" if k % 16 == 0 else "nan"
        out.append(f"{first_s + 0.01 * k:.4f},{float(value)!r},{current},{force_sign * 2.5},1.0,2.0,-3.0")
    return out


def read(tmp_path, lines):
    path = tmp_path / "rig.csv"
    path.write_text("\n".join(lines) + "\n")
    assert SmuRigCsv().recognises(path, path.read_bytes()[:4096])
    return SmuRigCsv().read(path, ReadOptions())


def test_readings_come_in_canonical_order_with_times_current_force_and_place(tmp_path):
    voltages = frames()
    recording = read(tmp_path, HEADER + lines_of(voltages))
    block = recording.frames
    np.testing.assert_array_equal(block.voltages, voltages)
    assert block.unit is VoltageUnit.VOLT
    assert block.current_A == pytest.approx(0.0009)
    np.testing.assert_allclose(np.diff(block.time_s), 2.56)
    assert block.reading_time_s[0, 3, 5] - block.reading_time_s[0, 0, 0] == pytest.approx(0.01 * (5 * 16 + 3))
    np.testing.assert_array_equal(scan_order(block), np.arange(256).reshape(16, 16).T.ravel())
    assert {s.channel: (s.unit, s.values[0]) for s in recording.samples} == {
        "force": ("N", 2.5),
        "x": ("mm", 1.0),
        "y": ("mm", 2.0),
        "z": ("mm", -3.0),
    }


def test_a_saturated_voltage_is_flagged_and_kept(tmp_path):
    lines = lines_of(frames())
    fields = lines[256 + 16 * 5 + 3].split(",")
    lines[256 + 16 * 5 + 3] = ",".join([fields[0], "19.8 MAX VOLTAGE ERROR", *fields[2:]])
    block = read(tmp_path, HEADER + lines).frames
    assert [tuple(at) for at in np.argwhere(block.flags)] == [(1, 3, 5)]
    assert block.flags[1, 3, 5] == ReadingFlag.COMPLIANCE
    assert block.voltages[1, 3, 5] == 19.8


def test_a_start_shifted_by_one_reading_is_noticed_and_undone(tmp_path):
    voltages = frames(5)
    recording = read(tmp_path, HEADER + lines_of(voltages)[1:])
    np.testing.assert_array_equal(recording.frames.voltages, voltages[1:])
    assert any("starts 1 reading late" in note for note in recording.notes)


def test_the_last_frame_may_be_cut_and_headers_may_repeat(tmp_path):
    voltages = frames(4)
    again = lines_of(voltages[2:])
    recording = read(tmp_path, HEADER + lines_of(voltages[:2])[: 256 * 2] + HEADER + again[:300])
    np.testing.assert_array_equal(recording.frames.voltages, voltages[:3])
    assert (np.diff(recording.frames.time_s) > 0).all()


@pytest.mark.parametrize(
    ("damage", "rejected", "said"),
    [
        *((lambda rows, bad=bad: [*rows[:300], bad, *rows[301:]], 1, said) for bad, said in (
            ("0.3,abc,nan,0,0,0,0", "'abc'"),
            ("0.3,1.0", "2 fields"),
            ("0.3,nan,nan,0,0,0,0", "possible"),
            ("0.3,0.1,inf,0,0,0,0", "possible"),
            ("0.3,1e300,nan,0,0,0,0", "possible"),
            ("1e300,0.1,nan,0,0,0,0", "possible"),
        )),
        (lambda rows: rows[:300] + rows[305:], 0, "5 lines are missing"),
        # More lines lost than lie between two current readings: counting alone would be 16 readings off.
        (lambda rows: rows[:300] + rows[320:], 0, "lines are missing"),
        (lambda rows: [*rows[:300], "3.0,0.01,nan,2.5,1.0,2.0,-3.0", *rows[300:]], 0, "1 too many"),
        (lambda rows: rows[:300] + HEADER + rows[300:], 0, "headers stand in it"),
        (lambda rows: [*rows[:300], rows[301], rows[300], *rows[302:]], 0, "steps back in it 1×, first in line 304"),
    ],
)  # fmt: skip
def test_damage_in_a_frame_costs_it_alone_and_is_said(tmp_path, damage, rejected, said):
    voltages = frames(5)
    recording = read(tmp_path, HEADER + damage(lines_of(voltages)))
    np.testing.assert_array_equal(recording.frames.voltages, voltages[[0, 2, 3, 4]])
    assert (recording.frames_dropped, recording.rows_rejected) == (1, rejected)
    assert recording.frames.current_A == pytest.approx(0.0009)
    assert sum("frame of lines 259 to" in p.what for p in recording.problems) == 1
    assert any(said in p.what for p in recording.problems)
    assert [p.line for p in recording.problems if p.rejected] == [303] * rejected


def test_compression_comes_out_positive(tmp_path):
    force = next(
        s for s in read(tmp_path, HEADER + lines_of(frames(), force_sign=-1)).samples if s.channel == "force"
    )
    assert force.values.max() == 2.5


def test_headers_only_and_half_a_frame_are_refused(tmp_path):
    with pytest.raises(RecordingError, match="only headers"):
        read(tmp_path, HEADER)
    with pytest.raises(RecordingError, match="no complete frame"):
        read(tmp_path, HEADER + lines_of(frames(1))[:200])


@pytest.mark.parametrize("at", [304, 305])  # a reading of the current, and another one
def test_a_line_written_twice_is_left_out_and_costs_nothing(tmp_path, at):
    voltages = frames(4)
    lines = lines_of(voltages)
    lines.insert(at, lines[at])
    recording = read(tmp_path, HEADER + lines)
    np.testing.assert_array_equal(recording.frames.voltages, voltages)
    (problem,) = recording.problems
    assert problem.rejected
    assert "twice" in problem.what
    assert problem.line == at + 4


def test_a_dead_driven_pair_does_not_move_the_scan(tmp_path):
    voltages = frames(4)
    voltages[:, 0, 0] = 0.0
    np.testing.assert_array_equal(read(tmp_path, HEADER + lines_of(voltages)).frames.voltages, voltages)


def test_missing_columns_are_named(tmp_path):
    lines = [",".join(line.split(",")[:3]) for line in (TITLES, *lines_of(frames(2)))]
    with pytest.raises(RecordingError, match=r"missing: f \[N\], x \[mm\], y \[mm\], z \[mm\]"):
        read(tmp_path, [HEADER[0], *lines])


def test_a_refused_file_says_how_many_lines_are_bad_and_keeps_them(tmp_path):
    lines = lines_of(frames(1))
    lines[5] = "0.1,abc,nan,0,0,0,0"
    with pytest.raises(RecordingError, match=r"256 lines, 1 of them bad \(the first in line 8: 'abc'") as said:
        read(tmp_path, HEADER + lines)
    assert [p.line for p in said.value.problems if p.rejected] == [8]


def test_garbage_behind_good_frames_is_given_up_on(tmp_path):
    voltages = frames(2)
    garbage = ["garbage"] * (MOST_BAD_IN_A_ROW + 500)
    recording = read(tmp_path, HEADER + lines_of(voltages) + garbage)
    np.testing.assert_array_equal(recording.frames.voltages, voltages)
    assert recording.rows_rejected == MOST_BAD_IN_A_ROW
    assert any("rest of the file was not read" in p.what for p in recording.problems)


def test_shuffled_lines_are_no_recording(tmp_path):
    lines = lines_of(frames())
    order = np.random.default_rng(1).permutation(len(lines))
    body = [",".join([*lines[k].split(",")[:2], line.split(",", 2)[2]]) for k, line in zip(order, lines, strict=True)]
    with pytest.raises(RecordingError, match="time steps back in it") as refused:
        read(tmp_path, HEADER + body)
    assert len(refused.value.problems) == 4


def test_a_step_back_of_the_clock_between_frames_is_listed(tmp_path):
    once = lines_of(frames())
    recording = read(tmp_path, HEADER + once + once)
    assert len(recording.frames) == 8
    (problem,) = recording.problems
    assert (problem.line, problem.rejected) == (1027, False)
    assert problem.what == "time steps back by 10.23 s from the frame before"
