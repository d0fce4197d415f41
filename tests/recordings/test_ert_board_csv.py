import re

import numpy as np
import pytest
from board_files import DUMP, PAIRS, BoardFile, counts
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.frames import VoltageUnit
from cbsr_qa.domain.recording import ReadOptions, ScanKind
from cbsr_qa_plugins.recordings.ert_board_csv import ErtBoardCsv
from cbsr_qa_plugins.recordings.text_lines import LONGEST_LINE, MOST_BAD_IN_A_ROW, text_lines

BLOCK = counts(5)


def read(path):
    format_ = ErtBoardCsv()
    assert format_.recognises(path, path.read_bytes()[:4096])
    return format_.read(path, ReadOptions())


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


def test_a_last_frame_that_is_whole_is_kept(tmp_path):
    recording = read(BoardFile().header().frames(BLOCK).save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK)


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


def damaged(damage):
    """One row in the middle of the third of five frames is damaged; returns the file and the row's line."""
    file = BoardFile().header()
    for k, frame in enumerate(BLOCK):
        file.mark().rows(frame[:6])
        if k == 2:
            file.row(frame[6])
            file.lines[-1] = damage(file.lines[-1])
            line = len(file.lines)
            file.rows(frame[7:])
        else:
            file.rows(frame[6:])
    return file.mark(), line


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda row: row.rstrip(",") + row.split(",", 3)[3], "joined"),
        (lambda row: ",".join(row.split(",")[:11]), "cut"),
        (lambda row: ",".join([*row.split(",")[:2], *row.split(",")[3:]]), "board's time"),
        (lambda row: ",".join([*row.split(",")[:7], "", *row.split(",")[8:]]), "empty field"),
        (lambda row: ",".join([*row.split(",")[:7], "8278219", *row.split(",")[8:]]), "16-bit"),
        (lambda row: ",".join([*row.split(",")[:2], "17", *row.split(",")[3:]]), "clock says 17 ms"),
        (lambda row: ",".join([*row.split(",")[:9], "nan", *row.split(",")[10:]]), "nan"),
        (lambda row: ",".join([*row.split(",")[:2], "nan", *row.split(",")[3:]]), "'nan' among the numbers"),
        (lambda row: ",".join([*row.split(",")[:2], "9" * 300, *row.split(",")[3:]]), "999"),
        (lambda row: ",".join([*row.split(",")[:2], str(2**32), *row.split(",")[3:]]), "counts in 32 bits"),
        (lambda row: ",".join(["1e300", *row.split(",")[1:]]), "does not start with a time"),
        (lambda row: row[:-1], "no comma"),
        (lambda row: row[:-2], "no comma"),
        (lambda row: row[:40] + "\x00" + row[40:], "among the numbers"),
        (lambda row: row + "1" * LONGEST_LINE, "more than"),
    ],
)
def test_a_bad_row_is_rejected_by_line_and_costs_its_frame(tmp_path, damage, said):
    file, line = damaged(damage)
    recording = read(file.save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK[[0, 1, 3, 4]])
    assert recording.rows_rejected == 1
    (problem,) = [p for p in recording.problems if p.rejected]
    assert problem.line == line
    assert said in problem.what
    assert "dropped" in problem.what
    assert recording.frames.time_s[2] - recording.frames.time_s[1] == pytest.approx(0.48)


def test_a_row_torn_by_a_dump_is_one_rejected_row(tmp_path):
    file = BoardFile().header().mark().rows(BLOCK[0]).mark().rows(BLOCK[1][:6])
    file.row(BLOCK[1][6])
    begin, rest = file.lines[-1].split(",")[:9], file.lines[-1].split(",")[10:]
    file.lines[-1] = ",".join([*begin, "-" + DUMP[0]])
    file.log(DUMP[1:]).payload(",".join(rest)).rows(BLOCK[1][7:]).frames(BLOCK[2:]).mark()
    recording = read(file.save(tmp_path))
    assert len(recording.frames) == 4
    assert recording.rows_rejected == 1


def test_lost_rows_cost_their_frame_and_are_said(tmp_path):
    file = BoardFile().header().mark().rows(BLOCK[0]).mark().rows(BLOCK[1][:12]).frames(BLOCK[2:]).mark()
    recording = read(file.save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK[[0, 2, 3, 4]])
    (problem,) = recording.problems
    assert "12 whole rows" in problem.what


def test_a_cut_first_line_of_sixteen_numbers_is_no_row(tmp_path):
    file = BoardFile().header().payload(",".join(["97"] * PAIRS)).frames(BLOCK).mark()
    recording = read(file.save(tmp_path))
    assert [(p.line, p.rejected) for p in recording.problems] == [(3, True)]


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


@pytest.mark.parametrize("times", [1, 3])
def test_headers_only_are_refused(tmp_path, times):
    file = BoardFile()
    for _ in range(times):
        file.header()
    with pytest.raises(RecordingError, match="only headers"):
        read(file.save(tmp_path))


def test_no_complete_frame_is_refused_with_an_inventory(tmp_path):
    with pytest.raises(RecordingError, match="no complete frame: 7 good rows, 0 rejected, 1 frame marks"):
        read(BoardFile().header().rows(BLOCK[0][:3]).mark().rows(BLOCK[0][:4]).save(tmp_path))


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.integers(0, 90), max_size=6, unique=True), st.randoms(use_true_random=False))
def test_whatever_happens_to_some_lines_the_other_frames_are_untouched(tmp_path, hit, random):
    """Damage to a line may cost its own frame and the one before a lost mark, never another one's content."""
    file = BoardFile().header().frames(BLOCK).mark()
    for index in hit:
        at = min(2 + index, len(file.lines) - 1)
        file.lines[at] = file.lines[at][: random.randrange(len(file.lines[at]) + 1)]
    try:
        recording = read(file.save(tmp_path))
    except RecordingError:
        return
    known = {frame.tobytes() for frame in BLOCK.astype(float)}
    assert all(frame.tobytes() in known for frame in recording.frames.voltages)


def as_a_spreadsheet_saves_it(file):
    return [line.rstrip(",") for line in file.lines]


def test_a_file_that_ends_inside_a_number_loses_that_frame_alone(tmp_path):
    file = BoardFile().header().frames(BLOCK)
    path = file.save(tmp_path)
    for text in ("\n".join(file.lines)[:-1], "\n".join(as_a_spreadsheet_saves_it(file))[:-1]):
        path.write_text(text)
        recording = read(path)
        np.testing.assert_array_equal(recording.frames.voltages, BLOCK[:4])
        assert [(p.line, p.rejected) for p in recording.problems] == [(len(file.lines), True)]
        assert recording.frames_dropped == 1


def test_rows_without_a_comma_at_their_end_are_whole_where_no_row_has_one(tmp_path):
    file = BoardFile().header().frames(BLOCK)
    file.lines = as_a_spreadsheet_saves_it(file)
    recording = read(file.save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK)
    assert recording.rows_rejected == 0


@pytest.mark.parametrize("mark", ["AA", "A123,4", "A-12,99,"])
def test_a_spoilt_mark_is_a_rejected_line_and_no_log(tmp_path, mark):
    file = BoardFile().header().frames(BLOCK[:2]).payload(mark).rows(BLOCK[2]).frames(BLOCK[3:])
    recording = read(file.save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK[[0, 3, 4]])
    (problem,) = recording.problems
    assert problem.rejected
    assert problem.line == 3 + 2 * (PAIRS + 1)
    assert "frame mark" in problem.what


def test_headers_inside_a_frame_cost_it_and_it_is_said_and_counted(tmp_path):
    file = BoardFile().header().frames(BLOCK[:2]).mark().rows(BLOCK[2][:7])
    file.header().rows(BLOCK[2][7:]).frames(BLOCK[3:])
    recording = read(file.save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK[[0, 1, 3, 4]])
    (problem,) = recording.problems
    assert problem.line == 3 + 2 * (PAIRS + 1)
    assert "7 whole rows" in problem.what
    assert "headers" in problem.what
    assert (recording.frames_dropped, recording.rows_rejected) == (1, 0)


def test_headers_right_behind_a_mark_cost_the_frame_and_it_is_said(tmp_path):
    file = BoardFile().header().frames(BLOCK[:2]).mark().header().rows(BLOCK[2]).frames(BLOCK[3:])
    recording = read(file.save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK[[0, 1, 3, 4]])
    assert recording.frames_dropped == 1
    assert "headers" in recording.problems[0].what


def test_a_recording_appended_behind_a_mark_drops_nothing(tmp_path):
    file = BoardFile().header().frames(BLOCK[:2]).mark().header().rows(BLOCK[2][9:]).frames(BLOCK[3:])
    recording = read(file.save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK[[0, 1, 3, 4]])
    assert (recording.frames_dropped, recording.problems) == (0, ())


@pytest.mark.parametrize("count", [15, 17])
def test_a_frame_of_another_number_of_rows_is_counted_as_dropped(tmp_path, count):
    odd = [*BLOCK[2], BLOCK[2][0]][:count]
    recording = read(BoardFile().header().frames(BLOCK[:2]).mark().rows(odd).frames(BLOCK[3:]).save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK[[0, 1, 3, 4]])
    assert (recording.frames_dropped, recording.rows_rejected) == (1, 0)


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


def test_a_refused_file_keeps_its_problems(tmp_path):
    file = BoardFile().header().rows(BLOCK[0][:3]).mark().rows(BLOCK[0][:4])
    file.lines[-1] = file.lines[-1][:-9]
    with pytest.raises(RecordingError) as said:
        read(file.save(tmp_path))
    assert [(p.line, p.rejected) for p in said.value.problems] == [(len(file.lines), True)]
    assert said.value.remedy


def test_garbage_behind_good_frames_is_given_up_on(tmp_path):
    """Memory and time are bounded by the lines looked at, not by the file."""
    file = BoardFile().header().frames(BLOCK)
    good = len(file.lines)
    file.lines += ["ÿ\x01garbage"] * (MOST_BAD_IN_A_ROW + 500) + file.lines[2:]
    recording = read(file.save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages[:4], BLOCK[:4])
    assert len(recording.frames) <= 5
    (last,) = [p for p in recording.problems if "rest of the file was not read" in p.what]
    assert last.line == good + MOST_BAD_IN_A_ROW
    assert recording.rows_rejected == MOST_BAD_IN_A_ROW


def test_a_line_without_an_end_is_read_in_bounded_pieces(tmp_path):
    path = tmp_path / "long.txt"
    path.write_bytes(b"a\r\n" + b"x" * (3 * LONGEST_LINE + 5) + b"\nb\rc")
    lines = list(text_lines(path))
    assert [(line.number, len(line.text), line.ended, line.too_long) for line in lines] == [
        (1, 1, True, False),
        (2, LONGEST_LINE, True, True),
        (3, 1, True, False),
        (4, 1, False, False),
    ]
    path.write_bytes(b"y" * LONGEST_LINE + b"\nz")
    assert [line.text[:1] for line in text_lines(path)] == ["y", "z"]


def test_old_line_ends_are_recognised(tmp_path):
    path = whole().save(tmp_path)
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r"))
    np.testing.assert_array_equal(read(path).frames.voltages, BLOCK)


def test_a_data_set_of_a_file_that_is_one_is_refused_with_a_remedy(tmp_path):
    with pytest.raises(RecordingError, match="none named 'x'") as said:
        ErtBoardCsv().read(whole().save(tmp_path), ReadOptions("x"))
    assert said.value.remedy
