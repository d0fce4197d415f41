"""Scenes written in the lab's formats and in our own, and read back by the formats themselves."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from tiers import rest_but
from written_scenes import (
    CURRENT_A,
    FORMATS,
    INNER,
    LAB,
    PERIOD_S,
    SIMULATED,
    made_up,
    middles_s,
    scan_offsets_s,
    simulated_press,
)

from cbsr_qa.app.analyse.analyse import analyse_file
from cbsr_qa.app.analyse.request import AnalyseRequest
from cbsr_qa.domain.plan.world import Dump
from cbsr_qa.domain.readings.frames import ReadingFlag, ReadOptions, VoltageUnit
from cbsr_qa.report.document import json_document
from cbsr_qa_plugins.recordings.ert_board_clock import NEWTON_PER_GRAM
from cbsr_qa_plugins.recordings.ert_board_csv import ErtBoardCsv
from cbsr_qa_plugins.recordings.ert_board_writer import END_COUNTS, counts_per_volt, scale_of

LOST = [(3, 5, 9), (7, 0, 2), (8, 15, 16)]
WHOLE = [k for k in range(12) if k not in {3, 7, 8}]
DUMPS = [Dump(1, 6, 0.075), Dump(3, 6, 0.075), Dump(9, 0, 0.075), Dump(9, 0, 0.075)]


def written(tmp_path, name, recording, transcript):
    """Write a recording; return what the format reads, and what it said it could not write."""
    path = tmp_path / "scene.file"
    notes = FORMATS[name]().write(path, recording, transcript)
    assert list(tmp_path.iterdir()) == [path]  # no temporary file is left
    head = path.read_bytes()[:4096]
    assert [other for other, format_ in FORMATS.items() if format_().recognises(path, head)] == [name]
    return FORMATS[name]().read(path, ReadOptions()), notes


def lines_of(tmp_path, name, recording, transcript):
    path = tmp_path / "lines.csv"
    FORMATS[name]().write(path, recording, transcript)
    return path.read_text(encoding="utf-8").splitlines()


def at(samples, name):
    return next(block for block in samples if block.channel == name)


def cut(voltages, gain):
    return np.clip(voltages, -END_COUNTS / gain, END_COUNTS / gain)


# --- ert-board-csv ---


def test_the_boards_scale_is_that_of_used_readings_and_driven_pairs_are_cut(tmp_path):
    """Readings of 0.1 V away from the driven electrodes, of 7 V at them, and one of 3 V in one frame, a fault."""
    apart = np.subtract.outer(np.arange(16), np.arange(16)) % 16
    voltages = np.where((apart > 1) & (apart < 15), 0.1, 7.0) * np.ones((9, 1, 1))
    voltages[4, 2, 9] = 3.0
    read, notes = written(tmp_path, "ert-board-csv", *made_up(9, inner="measure", readings=voltages))
    counts = read.frames.voltages
    assert 0.1 <= 0.1 * 2e5 / END_COUNTS <= 1  # 200 000 counts a volt: 1.5 × 0.1 V fill 30 000
    assert (counts[0][(apart > 1) & (apart < 15)] == 20_000).all()
    assert set(counts[:, apart < 2].ravel()) == {END_COUNTS} == {counts[4, 2, 9]}
    assert any("49 of the 256 readings" in note and "cut at 0.164 V" in note for note in notes)


def test_the_board_file_holds_counts_and_times_of_the_whole_frames(tmp_path):
    recording, transcript = made_up(12, inner="measure", lost=LOST)
    read, notes = written(tmp_path, "ert-board-csv", recording, transcript)
    gain = scale_of(recording.frames.voltages)
    assert read.frames.unit is VoltageUnit.COUNT
    off = read.frames.voltages / gain - cut(recording.frames.voltages[WHOLE], gain)
    assert np.abs(off).max() <= 0.5 / gain * (1 + 1e-9)
    assert any(f"{gain:g} counts per volt" in note for note in notes)
    np.testing.assert_allclose(read.frames.time_s, PERIOD_S * np.array(WHOLE), rtol=0, atol=1.1e-3)
    assert read.clock == "board"
    assert read.simulated == SIMULATED


@pytest.mark.parametrize(
    ("largest_V", "gain"),
    [(1.0, 2e4), (1.6, 2e4), (1.601, 1e4), (3.2, 1e4), (6.4, 5e3), (6.41, 2e3), (3.2e-4, 1e8), (3.3e-4, 5e7)],
)
def test_the_gain_is_the_largest_of_1_2_5_that_fits(largest_V, gain):
    assert counts_per_volt(largest_V) == gain


def test_compression_is_negative_grams_in_the_file_and_positive_newtons_again(tmp_path):
    recording, transcript = made_up(12, inner="measure")
    lines = lines_of(tmp_path, "ert-board-csv", recording, transcript)
    assert float(lines[-1].split(",")[1]) == pytest.approx(-4 / NEWTON_PER_GRAM, rel=0.01)
    force = at(ErtBoardCsv().read(tmp_path / "lines.csv", ReadOptions()).samples, "force")
    true = at(recording.samples, "force")
    expected = np.interp(force.time_s + recording.frames.time_s[0], true.time_s, true.values)
    # The board's milliseconds move the clocks to each other by as much; the force rises by 4 N in 30 s.
    np.testing.assert_allclose(force.values, expected, rtol=0, atol=4 / 30 * 2e-3 + 1e-5)


def test_a_cell_that_was_not_recorded_is_off(tmp_path):
    recording, transcript = made_up(3)
    read, _ = written(tmp_path, "ert-board-csv", replace(recording, samples=()), transcript)
    assert read.samples == ()


def test_frames_that_lost_rows_are_named_and_counted(tmp_path):
    read, notes = written(tmp_path, "ert-board-csv", *made_up(12, inner="measure", lost=LOST))
    assert read.frames_dropped == 3
    said = [problem.what for problem in read.problems]
    assert [f"{rows} whole rows" in what for rows, what in zip((12, 14, 15), said, strict=True)] == [True] * 3
    assert any("3 of 12 frames lost rows" in note for note in notes)


def test_a_mark_stands_before_what_arrives_of_a_frame(tmp_path):
    said = [
        line.split(",")[2]
        for line in lines_of(tmp_path, "ert-board-csv", *made_up(5, lost=[(1, 0, 2), (3, 0, 16)]))[2:]
    ]
    marks = [k for k, field in enumerate(said) if field == "A"]
    assert [len(frame) for frame in np.split(said, marks)] == [0, 17, 15, 17, 17]


def test_dumps_are_noted_cost_nothing_and_make_the_board_late(tmp_path):
    recording, transcript = made_up(12, inner="measure", dumps=DUMPS)
    read, _ = written(tmp_path, "ert-board-csv", recording, transcript)
    assert len(read.frames) == 12
    assert read.rows_rejected == read.frames_dropped == 0
    assert ["watchdog dump" in p.what for p in read.problems] == [True] * 3  # two of them follow each other
    assert [("15 lines" in p.what, "30 lines" in p.what) for p in read.problems] == [(True, False)] * 2 + [
        (False, True)
    ]
    late_s = transcript.pauses_s()
    middle_s = middles_s(12) + (late_s[:, 0] + late_s[:, -1]) / 2
    np.testing.assert_allclose(read.frames.time_s, middle_s - middle_s[0], rtol=0, atol=1.1e-3)
    assert read.frames.time_s[-1] == pytest.approx(11 * PERIOD_S + 4 * 0.075, abs=2e-3)


def test_lines_of_a_dump_stand_in_time_before_their_row(tmp_path):
    lines = lines_of(tmp_path, "ert-board-csv", *made_up(4, inner="measure", dumps=[Dump(1, 6, 0.075)]))
    first = next(k for k, line in enumerate(lines) if "task_wdt" in line)
    assert first == 2 + 17 + 1 + 6  # headers, a frame with its mark, a mark, six rows
    time_s = [float(line.split(",")[0]) for line in lines[2:]]
    assert (np.diff(time_s) >= 0).all()
    assert time_s[first + 13] - time_s[first - 2] == pytest.approx(0.075, abs=2e-6)


def test_frames_taken_at_once_have_one_time_a_frame(tmp_path):
    recording, transcript = made_up(5, dumps=[Dump(2, 3, 0.1)])
    read, notes = written(tmp_path, "ert-board-csv", recording, transcript)
    np.testing.assert_allclose(read.frames.time_s, recording.frames.time_s - 1.25, rtol=0, atol=1.1e-3)
    assert any("taken at once" in note for note in notes)


def test_a_written_file_is_built_like_a_real_one(tmp_path, shared):
    real = (shared / "data" / "black_sensor" / "expABCX_150mm_8.5wt_6.csv").read_text(encoding="utf-8").splitlines()
    ours = lines_of(tmp_path, "ert-board-csv", *made_up(12, inner="measure", dumps=DUMPS[:2]))

    def built(lines):
        """Fields of marks and rows, whether rows end with a comma, rows from mark to mark, lines of a dump."""
        fields = [line.split(",") for line in lines]
        marks = [k for k, parts in enumerate(fields) if parts[2:] == ["A"]]
        rows = [k for k, parts in enumerate(fields) if len(parts) == 20]
        between = {sum(first < k < last for k in rows) for first, last in pairwise(marks)}
        dumps = [k for k, line in enumerate(lines) if "Task watchdog got triggered" in line]
        lengths = {next(k for k in rows if k > start) - start for start in dumps}
        closed = {lines[k].endswith(",") for k in rows}
        whole = all(part.lstrip("-").isdigit() for k in rows for part in fields[k][2:19])
        return len(fields[marks[0]]), between, closed, whole, lengths

    assert built(ours) == built(real)
    assert ours[1] == real[1]
    assert real[0].startswith("UTC:,20")
    assert ours[0].startswith("UTC:,20")


# --- smu-rig-csv ---


@pytest.mark.parametrize("inner", ["drive", None])
def test_the_rigs_file_holds_readings_flags_times_current_force_and_place(tmp_path, inner):
    flags = np.zeros((12, 16, 16), np.uint8)
    flags[2, 3, :] = ReadingFlag.COMPLIANCE
    flags[4, 1, 1] = ReadingFlag.COMPLIANCE | ReadingFlag.SATURATED
    recording, transcript = made_up(12, inner=inner, flags=flags)
    read, _ = written(tmp_path, "smu-rig-csv", recording, transcript)
    np.testing.assert_array_equal(read.frames.voltages, recording.frames.voltages)
    np.testing.assert_array_equal(read.frames.flags, flags & ReadingFlag.COMPLIANCE)
    assert read.frames.current_A == CURRENT_A
    np.testing.assert_allclose(read.frames.time_s, PERIOD_S * np.arange(12), rtol=0, atol=2e-6)
    own = scan_offsets_s("drive") if inner else np.zeros((16, 16))
    np.testing.assert_allclose(read.frames.reading_time_s[0], own, rtol=0, atol=2e-6)
    for name in ("force", "x", "y", "z"):
        block, true = at(read.samples, name), at(recording.samples, name)
        expected = np.interp(block.time_s + 1.25, true.time_s, true.values)
        np.testing.assert_allclose(block.values, expected, rtol=1e-5, atol=1e-5)
    assert read.simulated == SIMULATED


def test_channels_nobody_recorded_are_nan_and_said(tmp_path):
    recording, transcript = made_up(3)
    only = replace(recording, samples=recording.samples[:1])
    read, notes = written(tmp_path, "smu-rig-csv", only, transcript)
    assert [block.channel for block in read.samples] == ["force"]
    assert any("x, y, z" in note for note in notes)


def test_the_current_stands_in_every_16th_line(tmp_path):
    rows = [line.split(",") for line in lines_of(tmp_path, "smu-rig-csv", *made_up(3))[2:]]
    assert len(rows) == 3 * 256
    assert [k for k, row in enumerate(rows) if row[2] != "nan"] == list(range(0, 3 * 256, 16))


def test_the_rig_says_that_it_has_no_dumps(tmp_path):
    recording, transcript = made_up(12, dumps=DUMPS)
    read, notes = written(tmp_path, "smu-rig-csv", recording, transcript)
    assert any("4 watchdog dumps are not written" in note for note in notes)
    np.testing.assert_allclose(read.frames.time_s, recording.frames.time_s - 1.25, rtol=0, atol=2e-6)
    assert not read.problems


# --- cbsr-recording ---


def test_our_own_file_holds_everything_of_the_whole_frames(tmp_path):
    recording, transcript = made_up(12, inner="measure", lost=LOST, dumps=DUMPS)
    read, notes = written(tmp_path, "cbsr-recording", recording, transcript)
    np.testing.assert_array_equal(read.frames.voltages, recording.frames.voltages[WHOLE])
    zero_s = recording.frames.time_s[0]
    np.testing.assert_array_equal(read.frames.reading_time_s, recording.frames.reading_time_s[WHOLE] - zero_s)
    assert read.frames_dropped == 3
    assert (read.sensor_type, read.layout, read.simulated) == ("disc-100mm", recording.layout, SIMULATED)
    assert [load.press_start_s for load in read.loads] == [5.0 - zero_s]
    assert [block.channel for block in read.samples] == ["force", "x", "y", "z"]
    assert any("3 of 12 frames" in note for note in notes)
    assert any("4 watchdog dumps" in note for note in notes)


def test_nothing_lost_is_nothing_to_say(tmp_path):
    read, notes = written(tmp_path, "cbsr-recording", *made_up(3))
    assert notes == ()
    assert read.frames_dropped == 0


# --- all ---


@pytest.mark.parametrize("name", LAB)
@pytest.mark.parametrize("seed", rest_but({0}, range(6)))
def test_whatever_rows_are_lost_the_whole_frames_are_read(tmp_path, name, seed):
    """Any rows of up to a fourth of the frames, frames beside each other and all rows of a frame included."""
    rng = np.random.default_rng(seed)
    recording, transcript = made_up(40, inner=INNER[name])
    for frame in rng.choice(np.arange(1, 39), 10, replace=False):
        transcript.lost[frame] = rng.random(16) < rng.choice([0.1, 0.5, 1.1])
    any_, all_ = transcript.lost.any(axis=1), transcript.lost.all(axis=1)
    assert all_.any()
    read, _ = written(tmp_path, name, recording, transcript)
    assert len(read.frames) == np.sum(~any_)
    assert read.frames_dropped == np.sum(any_ & ~all_)
    gain = scale_of(recording.frames.voltages) if name == "ert-board-csv" else 1
    expected = recording.frames.voltages[~any_] if gain == 1 else cut(recording.frames.voltages[~any_], gain)
    np.testing.assert_allclose(read.frames.voltages / gain, expected, rtol=0, atol=0.5 / 1e3)


@pytest.mark.parametrize("name", FORMATS)
def test_the_same_scene_gives_the_same_bytes(tmp_path, name):
    recording, transcript = made_up(4, lost=[(1, 2, 4)], dumps=[Dump(2, 3, 0.075)])
    paths = [tmp_path / "one", tmp_path / "two"]
    for path in paths:
        FORMATS[name]().write(path, replace(recording, path=path), transcript)
    assert paths[0].read_bytes() == paths[1].read_bytes()


@pytest.mark.parametrize("name", LAB)
def test_what_a_lab_file_cannot_say_is_said(tmp_path, name):
    flags = np.zeros((3, 16, 16), np.uint8)
    flags[1, 2] = ReadingFlag.SATURATED
    notes = "\n".join(written(tmp_path, name, *made_up(3, flags=flags))[1])
    for said in ("1 presses", "sensor type", "16 readings are flagged", "one remark", "taken at once"):
        assert said in notes


@pytest.mark.parametrize("name", LAB)
def test_a_long_text_on_what_was_simulated_does_not_hide_the_titles(tmp_path, name):
    recording, transcript = made_up(3)
    said = tuple(f'effect {k}, with "quotes" and a\nline end' for k in range(200))
    read, _ = written(tmp_path, name, replace(recording, simulated=said), transcript)
    assert read.simulated[0] == "effect 0; with 'quotes' and a line end"
    assert len(read.frames) == 3


@pytest.mark.parametrize("name", LAB)
def test_what_nobody_simulated_is_not_marked(tmp_path, name):
    recording, transcript = made_up(3)
    assert written(tmp_path, name, replace(recording, simulated=()), transcript)[0].simulated == ()


# --- a simulated press, through each format to what analyse finds ---


@pytest.mark.parametrize("name", rest_but({"smu-rig-csv"}, FORMATS))
def test_a_simulated_press_is_found_where_and_when_it_was(tmp_path, name):
    recording, transcript, change = simulated_press(INNER.get(name, "measure"))
    assert transcript.lost.any()
    assert bool(transcript.dumps) == (INNER.get(name) != "drive")
    path = tmp_path / "scene.file"
    FORMATS[name]().write(path, recording, transcript)
    analysed = analyse_file(path, AnalyseRequest(sensor_type="disc-100mm", report=False))
    assert analysed.refused is None
    found = json_document(analysed)
    assert found["recording"]["format"] == name
    assert found["recording"]["simulated"] == list(SIMULATED)
    assert found["recording"]["frames_dropped"] == transcript.lost.any(axis=1).sum() > 0
    (event,) = found["events"]
    assert (event["x_mm"], event["y_mm"]) == pytest.approx((20, 15), abs=2.5)
    late_s = transcript.pauses_s()[24, 0]
    zero_s = recording.frames.time_s[0]
    assert event["start_s"] == pytest.approx(60 + 0.6 - zero_s, abs=PERIOD_S + late_s)
    assert event["end_s"] == pytest.approx(105 + 0.6 - zero_s, abs=PERIOD_S + late_s)
    assert event["sign"] == np.sign(change)
    assert event["force_N"] == pytest.approx(at(recording.samples, "force").values.max(), rel=0.05)
