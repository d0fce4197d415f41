"""Files of the lab's recorder scripts: every layout of them, their clocks, forces and currents."""

import re

import numpy as np
import pytest
from board_files import BLOCK, DUMP, PAIRS, BoardFile, counts, read

from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.readings.frames import ReadOptions, ScanKind, VoltageUnit
from cbsr_qa_plugins.recordings.ert_board_csv import ErtBoardCsv


def whole(**options):
    return BoardFile(**options).header().rows(counts(1)[0, 7:]).frames(BLOCK).mark().rows(counts(1)[0, :5])


@pytest.mark.parametrize("mass", [True, False])
@pytest.mark.parametrize("clock", [True, False])
def test_every_layout_gives_the_same_frames(tmp_path, mass, clock):
    recording = read(whole(mass=mass, clock=clock).save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK)
    assert recording.frames.unit is VoltageUnit.COUNT
    assert recording.clock == ("board" if clock else "computer")
    assert recording.scan is ScanKind.FULL
    assert recording.rows_rejected == 0
    assert recording.problems == ()  # the first partial and the last unfinished frame are normal
    assert recording.frames.current_A == pytest.approx(None if mass else 105e-6)
    np.testing.assert_allclose(recording.frames.time_s, np.arange(5) * 0.24, atol=1e-9)


def test_saved_again_by_a_spreadsheet(tmp_path):
    file = whole()
    file.lines[0] = "UTC:,26:11.6"
    width = max(line.count(",") for line in file.lines)
    file.lines = [line.rstrip(",") + "," * (width - line.rstrip(",").count(",")) for line in file.lines]
    path = file.save(tmp_path)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    np.testing.assert_array_equal(read(path).frames.voltages, BLOCK)


def test_whole_seconds_are_spread_over_the_recording(tmp_path):
    file = BoardFile(mass=False, clock=False)
    file.header()
    for k, values in enumerate(counts(500, 1)[:, 0]):
        file.now_s = float(1657507208 + k // 100)
        file.mark().payload(",".join(map(str, values)))
    recording = read(file.save(tmp_path))
    assert len(recording.frames) == 500
    np.testing.assert_allclose(np.diff(recording.frames.time_s), 0.01, rtol=1e-4)
    assert any("spreadsheet" in note for note in recording.notes)


def test_a_watchdog_dump_does_not_cost_its_frame(tmp_path):
    file = BoardFile().header()
    for frame in BLOCK:
        file.mark().rows(frame[:9])
        if frame is BLOCK[2] or np.array_equal(frame, BLOCK[2]):
            file.log()
        file.rows(frame[9:])
    recording = read(file.mark().save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK)
    assert recording.rows_rejected == 0
    (dump,) = recording.problems
    assert "watchdog dump" in dump.what
    assert f"{len(DUMP)} lines" in dump.what
    assert not dump.rejected


def test_calibration_mode_is_one_row_a_frame_whatever_the_log_says(tmp_path):
    rows = counts(40, 1)
    file = BoardFile(mass=False, clock=False).header().payload("MODE = FULL SCAN").row(rows[0, 0])
    for frame in rows[1:]:
        file.mark().rows(frame)
    recording = read(file.mark().save(tmp_path))
    assert recording.scan is ScanKind.DRIVEN_PAIRS
    np.testing.assert_array_equal(recording.frames.voltages, rows)


def test_unsigned_counts_printed_as_signed(tmp_path):
    true = np.random.default_rng(5).integers(40_000, 50_000, (30, 1, PAIRS))
    file = BoardFile(mass=False, clock=False).header()
    for frame in true:
        file.mark().rows(np.where(frame > 32767, frame - 65536, frame))
    np.testing.assert_array_equal(read(file.save(tmp_path)).frames.voltages, true)


def test_bytes_literals_are_opened(tmp_path):
    file = whole()
    file.lines[2:] = [f"{line.split(',')[0]},b'0.62',{line.split(',', 2)[2]}" for line in file.lines[2:]]
    recording = read(file.save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK)
    np.testing.assert_allclose(recording.samples[0].values, -0.62 * 9.80665e-3)


def test_whole_serial_lines_in_one_quoted_field(tmp_path):
    file = whole()
    file.lines[2:] = [f"{line.split(',')[0]},\"b'{line.split(',', 2)[2]}\\r\\n'\"," for line in file.lines[2:]]
    recording = read(file.save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK)
    assert recording.samples == ()
    assert recording.clock == "board"


def test_appended_recordings_follow_each_other(tmp_path):
    file = BoardFile(clock=False).header().frames(BLOCK[:2]).mark().rows(BLOCK[4][:3])
    again = BoardFile(clock=False)
    again.header().frames(BLOCK[2:4])
    again.lines[0] = "UTC:,2022-04-05 00:27:11.636727"
    file.lines += again.lines
    recording = read(file.save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK[:4])
    assert recording.frames.time_s[2] - recording.frames.time_s[0] == pytest.approx(60, abs=0.1)


def test_the_boards_clock_stepping_back_is_bridged(tmp_path):
    file = BoardFile().header().frames(BLOCK[:2])
    file.board_ms = 40
    recording = read(file.frames(BLOCK[2:]).save(tmp_path))
    np.testing.assert_allclose(np.diff(recording.frames.time_s), 0.24, atol=1e-9)
    assert any("steps back" in p.what and not p.rejected for p in recording.problems)


def test_a_jump_of_the_boards_clock_is_kept_and_said(tmp_path):
    file = BoardFile().header().frames(BLOCK[:2])
    file.board_ms += 2000
    file.now_s += 2.0
    recording = read(file.frames(BLOCK[2:]).save(tmp_path))
    assert np.diff(recording.frames.time_s)[1] == pytest.approx(2.24)
    assert any("jumps by 2015 ms" in p.what for p in recording.problems)


def test_compression_is_negative_grams_and_becomes_positive_newtons(tmp_path):
    file = BoardFile(mass_g=0.0).header().frames(BLOCK[:1])
    file.mass_g = -500.0
    (force,) = read(file.frames(BLOCK[1:]).save(tmp_path)).samples
    assert (force.channel, force.unit) == ("force", "N")
    assert force.values.max() == pytest.approx(4.903325)
    assert force.time_s[force.values > 1].min() == pytest.approx(0.12, abs=0.02)


def test_a_load_cell_that_was_off_is_not_recorded_force(tmp_path):
    assert read(whole(mass_g=0.0).save(tmp_path)).samples == ()


def test_force_on_marks_only_on_a_slow_computer(tmp_path):
    """Rows wait in the buffer: the mass beside a row is younger than its readings, and zeros beside rows are none."""
    file = BoardFile().header()
    for k, frame in enumerate(BLOCK):
        file.mass_g = -100.0 * (k + 1)
        file.mark()
        file.mass_g = 0.0
        for values in frame:
            file.row(values)
            file.now_s += 0.045  # the computer takes four times as long as the board
    recording = read(file.save(tmp_path))
    np.testing.assert_allclose(np.diff(recording.frames.time_s), 0.24, atol=1e-9)
    (force,) = recording.samples
    assert len(force) == 5
    np.testing.assert_allclose(np.diff(force.time_s), 0.96, atol=1e-6)
    assert any("after the board sent them" in note for note in recording.notes)


def test_a_recording_appended_behind_a_mark_drops_nothing(tmp_path):
    file = BoardFile().header().frames(BLOCK[:2]).mark().header().rows(BLOCK[2][9:]).frames(BLOCK[3:])
    recording = read(file.save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK[[0, 1, 3, 4]])
    assert (recording.frames_dropped, recording.problems) == (0, ())


@pytest.mark.parametrize(
    ("stated", "current_A"),
    [("105", 105e-6), ("nan", None), ("inf", None), ("-5", None), ("0", None), ("1e300", None), ("100plus", None)],
)
def test_what_is_no_current_is_not_stated_and_said(tmp_path, stated, current_A):
    file = whole(mass=False)
    file.lines[1] = f"Isrc:,{stated}"
    recording = read(file.save(tmp_path))
    assert recording.frames.current_A == (None if current_A is None else pytest.approx(current_A))
    assert any(repr(stated) in note for note in recording.notes) == (current_A is None)


def test_appended_recordings_of_different_currents_state_none(tmp_path):
    file = BoardFile(mass=False).header().frames(BLOCK[:2]).header().frames(BLOCK[2:])
    file.lines[1] = "Isrc:,24"
    recording = read(file.save(tmp_path))
    assert recording.frames.current_A is None
    assert any("24" in note and "105" in note for note in recording.notes)


def test_a_board_clock_that_stands_still_gives_way_to_the_computers(tmp_path):
    file = BoardFile().header().frames(BLOCK)
    file.lines = [re.sub(r",17\d{4},", ",5000,", line) for line in file.lines]
    recording = read(file.save(tmp_path))
    assert recording.clock == "computer"
    np.testing.assert_allclose(np.diff(recording.frames.time_s), 0.24, atol=1e-9)
    (problem,) = recording.problems
    assert "stands still" in problem.what
    assert not problem.rejected
    assert any("stands still" in note for note in recording.notes)


def test_old_line_ends_are_recognised(tmp_path):
    path = whole().save(tmp_path)
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r"))
    np.testing.assert_array_equal(read(path).frames.voltages, BLOCK)


def test_a_data_set_of_a_file_that_is_one_is_refused_with_a_remedy(tmp_path):
    with pytest.raises(RecordingError, match="none named 'x'") as said:
        ErtBoardCsv().read(whole().save(tmp_path), ReadOptions("x"))
    assert said.value.remedy


@pytest.mark.parametrize("factor", [40, 1000, 123_457])
def test_counts_times_a_constant_are_divided_by_it(tmp_path, factor):
    recording = read(BoardFile().header().frames(BLOCK * factor).save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK)
    assert recording.rows_rejected == 0
    assert any(f"divided by {factor}" in note for note in recording.notes)


def test_a_damaged_row_among_scaled_ones_is_rejected_alone(tmp_path):
    file = BoardFile().header().frames(BLOCK * 1000)
    file.lines[5] = file.lines[5].replace("000,", "007,", 3)
    recording = read(file.save(tmp_path))
    assert [problem.line for problem in recording.problems if problem.rejected] == [6]
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK[1:])


def test_wide_counts_without_a_common_factor_are_read_as_they_are(tmp_path):
    wide = np.rint(BLOCK * 77.7)
    recording = read(BoardFile().header().frames(wide).save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, wide)
    assert any("no common factor" in note for note in recording.notes)
    assert recording.rows_rejected == 0


def test_counts_of_16_bits_are_not_scaled(tmp_path):
    recording = read(BoardFile().header().frames(BLOCK // 40 * 40).save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK // 40 * 40)
    assert recording.notes == read(BoardFile().header().frames(BLOCK).save(tmp_path)).notes
