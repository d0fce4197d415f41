"""Damaged files of the lab's recorder scripts: what a bad line costs, what is said of it, and what is refused."""

import numpy as np
import pytest
from board_files import BLOCK, DUMP, PAIRS, BoardFile, read
from drawn import drawn
from hypothesis import HealthCheck, given, strategies as st

from cbsr_qa.domain.errors import RecordingError
from cbsr_qa_plugins.recordings.lab_files import LONGEST_LINE, MOST_BAD_IN_A_ROW, text_lines


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


@pytest.mark.parametrize(
    ("third", "said"),
    [
        (lambda file: file.mark().rows(BLOCK[2][:12]), "12 whole rows"),
        (lambda file: file.mark().rows(BLOCK[2][:15]), "15 whole rows"),
        (lambda file: file.mark().rows([*BLOCK[2], BLOCK[2][0]]), "17 whole rows"),
        (lambda file: file.mark().rows(BLOCK[2][:7]).header().rows(BLOCK[2][7:]), "7 whole rows"),
        (lambda file: file.mark().header().rows(BLOCK[2]), "headers"),
    ],
)  # fmt: skip
def test_a_frame_that_is_not_whole_is_dropped_and_said_by_its_first_line(tmp_path, third, said):
    file = BoardFile().header().frames(BLOCK[:2])
    recording = read(third(file).frames(BLOCK[3:]).save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK[[0, 1, 3, 4]])
    (problem,) = recording.problems
    assert problem.line == 3 + 2 * (PAIRS + 1)
    assert said in problem.what
    assert (recording.frames_dropped, recording.rows_rejected) == (1, 0)


@pytest.mark.parametrize("mark", ["AA", "A123,4", "A-12,99,"])
def test_a_spoilt_mark_is_a_rejected_line_and_no_log(tmp_path, mark):
    file = BoardFile().header().frames(BLOCK[:2]).payload(mark).rows(BLOCK[2]).frames(BLOCK[3:])
    recording = read(file.save(tmp_path))
    np.testing.assert_array_equal(recording.frames.voltages, BLOCK[[0, 3, 4]])
    (problem,) = recording.problems
    assert problem.rejected
    assert problem.line == 3 + 2 * (PAIRS + 1)
    assert "frame mark" in problem.what


def test_a_cut_first_line_of_sixteen_numbers_is_no_row(tmp_path):
    file = BoardFile().header().payload(",".join(["97"] * PAIRS)).frames(BLOCK).mark()
    recording = read(file.save(tmp_path))
    assert [(p.line, p.rejected) for p in recording.problems] == [(3, True)]


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


@drawn(40, suppress_health_check=[HealthCheck.function_scoped_fixture])
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
