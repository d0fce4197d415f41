"""Tables of frames in any pattern as recordings: presses are found where they are, and noise is none."""

from itertools import combinations

import numpy as np
import pytest
from pressed_sheets import adjacent_pairs, opposite_pairs, readings, round_sensor

from cbsr_qa.analysis.recording.analysis import AnalysisChoices, analyse_recording
from cbsr_qa.analysis.recording.table_files import PairFrames, check_form, record_pairs
from cbsr_qa.calibration.presses.frame_tables import ComplexPart, FrameTable
from cbsr_qa.domain.errors import RecordingError, RefusedError
from cbsr_qa.domain.readings.frames import ReadingFlag
from cbsr_qa_plugins.reconstruction.one_step import GaussNewtonNoser

PLACES = np.array([[20.0, 5.0], [-25.0, 12.0], [0.0, -30.0], [3.0, -2.0]])


def ohmmeter_pairs(count):
    return np.array([(a, b, a, b) for a, b in combinations(range(count), 2)])


def table(tmp_path, rows, time_s=None, name="frames.csv"):
    return FrameTable(tmp_path / name, tuple(map(str, range(rows.shape[1]))), rows, time_s)


def analysed(pairs, frames, sensor, rest=None, *, differences=False, part=None):
    recording, sensor_type = record_pairs(PairFrames(pairs, frames, rest), sensor, part, differences=differences)
    return analyse_recording(recording, GaussNewtonNoser(), AnalysisChoices(sensor_type=sensor_type))


def errors_mm(result, places):
    return [np.hypot(e.x_mm - places[round(e.peak_s), 0], e.y_mm - places[round(e.peak_s), 1]) for e in result.events]


@pytest.mark.parametrize(
    ("count", "pairs", "tolerance_mm"),
    [
        (8, adjacent_pairs(8), 4.0),
        (8, ohmmeter_pairs(8), 5.0),
        pytest.param(16, ohmmeter_pairs(16), 4.0, marks=pytest.mark.rest),
        pytest.param(16, opposite_pairs(16), 4.0, marks=pytest.mark.rest),
        pytest.param(32, adjacent_pairs(32), 4.0, marks=pytest.mark.rest),
    ],
)
def test_each_row_is_a_frame_of_its_own_against_frames_at_rest(tmp_path, count, pairs, tolerance_mm):
    """28 readings of 8 electrodes, all pairs of an ohmmeter, are frames as any others."""
    sensor = round_sensor(count=count)
    order = np.random.default_rng(1).permutation(len(pairs))  # columns may have any order
    loaded, unloaded = readings(sensor, pairs[order], PLACES, contrast=0.3)
    noise = 0.02 * np.median(np.abs(loaded - unloaded))
    random = np.random.default_rng(2)
    rows = np.vstack([loaded, unloaded]) + noise * random.standard_normal((5, len(pairs)))
    rest = unloaded + noise * random.standard_normal((8, len(pairs)))
    result = analysed(pairs[order], table(tmp_path, rows), sensor, table(tmp_path, rest))
    assert sorted(round(event.peak_s) for event in result.events) == [0, 1, 2, 3]
    assert max(errors_mm(result, PLACES)) < tolerance_mm
    assert {event.sign for event in result.events} == {1}
    changes = analysed(pairs[order], table(tmp_path, rows - rest.mean(axis=0)), sensor, differences=True)
    assert max(errors_mm(changes, PLACES)) < tolerance_mm
    assert changes.channels.snr_db is None
    assert any("unknown scale" in note for note in changes.recording.notes)


def test_presses_in_time_are_found_without_frames_at_rest(tmp_path):
    sensor, pairs = round_sensor(count=8), adjacent_pairs(8)
    loaded, unloaded = readings(sensor, pairs, PLACES[:1], contrast=0.3)
    pressed = np.zeros((80, 1))
    pressed[30:60] = 1
    noise = 0.05 * np.median(np.abs(loaded - unloaded))
    rows = unloaded + pressed * (loaded - unloaded)
    rows = 1e-3 * (rows + noise * np.random.default_rng(3).standard_normal(rows.shape))
    result = analysed(pairs, table(tmp_path, rows, 0.25 * np.arange(80)), sensor)
    (event,) = result.events
    assert (event.start_s, event.end_s) == pytest.approx((7.4, 14.9), abs=0.3)
    assert np.hypot(event.x_mm - 20, event.y_mm - 5) < 2
    assert result.frame_rate_hz == pytest.approx(4)
    assert result.noise.unit == "units"


def test_complex_readings_keep_the_place(tmp_path):
    """A quarter of the resistance as reactance: magnitudes have no signs, and the place stays."""
    sensor, pairs = round_sensor(count=8), adjacent_pairs(8)
    loaded, unloaded = readings(sensor, pairs, PLACES[:2], contrast=0.3)
    rows, rest = np.abs(loaded + 0.25j * unloaded), np.abs(unloaded + 0.25j * unloaded)
    rest = rest + 1e-6 * np.random.default_rng(4).standard_normal((4, len(rest)))
    result = analysed(pairs, table(tmp_path, rows), sensor, table(tmp_path, rest), part=ComplexPart.MAGNITUDE)
    assert max(errors_mm(result, PLACES)) < 4
    with pytest.raises(RefusedError, match="differences have no in-phase part: the readings"):
        check_form(ComplexPart.IN_PHASE, differences=True, rest=False)


@pytest.mark.rest
@pytest.mark.parametrize("pairs", [adjacent_pairs(8), opposite_pairs(8), adjacent_pairs(16)], ids=len)
@pytest.mark.parametrize("proportional", [False, True])
def test_noise_is_no_load_in_any_row(tmp_path, pairs, proportional):
    """No false alarm in 200 rows each: the noise of each reading is learned from what loads leave."""
    sensor = round_sensor(count=int(pairs.max()) + 1)
    _, unloaded = readings(sensor, pairs, PLACES[:1], contrast=0.3)
    sigma = 1e-3 * (np.abs(unloaded) if proportional else np.full(len(unloaded), np.median(np.abs(unloaded))))
    random = np.random.default_rng(5)
    rows, rest = (unloaded + sigma * random.standard_normal((n, len(unloaded))) for n in (200, 10))
    for time_s in (None, np.arange(200.0)):
        assert not analysed(pairs, table(tmp_path, rows, time_s), sensor, table(tmp_path, rest)).events


def test_what_the_table_does_not_hold_is_missing_and_repeats_are_averaged(tmp_path):
    sensor, pairs = round_sensor(count=8), adjacent_pairs(8)
    twice = np.vstack([pairs[:5], pairs[:5]])
    rows = np.arange(10.0)[None] + np.zeros((3, 1))
    recording, sensor_type = record_pairs(PairFrames(twice, table(tmp_path, rows)), sensor)
    held = (recording.frames.flags & ReadingFlag.MISSING) == 0
    assert held.sum() == 3 * 5
    np.testing.assert_allclose(recording.frames.voltages[0][held[0]], np.arange(5) + 2.5)
    assert sensor_type.pattern.drive[0] == (0, 1)
    assert recording.notes[0] == "5 of 5 pairs stand in several columns, which are averaged"


def test_too_many_pairs_or_rows_are_refused_by_their_numbers(tmp_path):
    pairs = ohmmeter_pairs(33)
    with pytest.raises(RecordingError, match="528 drive pairs × 528 measure pairs are 278784 combinations"):
        record_pairs(PairFrames(pairs, table(tmp_path, np.zeros((1, 528)))), round_sensor(count=33))
    clear = np.array([(a, b, (b + 1) % 16, (b + 2) % 16) for a, b in combinations(range(16), 2) if a > 2])
    mixed = np.vstack([ohmmeter_pairs(16), clear])
    with pytest.raises(RecordingError, match="at most 8192 are imaged, however many"):
        record_pairs(PairFrames(mixed, table(tmp_path, np.zeros((1, len(mixed))))), round_sensor(count=16))
    pairs = ohmmeter_pairs(32)
    with pytest.raises(RecordingError, match=r"300 rows of 496 drive .*; at most 272 rows are imaged at a time"):
        record_pairs(PairFrames(pairs, table(tmp_path, np.zeros((300, 496)))), round_sensor(count=32))


def pressed_rows(count=12):
    """Changes by presses at as many places, with noise; the pairs, the sensor and the places."""
    sensor, pairs, random = round_sensor(count=16), opposite_pairs(16), np.random.default_rng(6)
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    places = 35 * np.column_stack([np.cos(angle), np.sin(angle)])
    loaded, unloaded = readings(sensor, pairs, places, contrast=0.3)
    changes = loaded - unloaded
    return pairs, sensor, places, changes + 0.05 * np.median(np.abs(changes)) * random.standard_normal(changes.shape)


@pytest.mark.rest
def test_a_row_of_changes_in_another_unit_is_named(tmp_path):
    pairs, sensor, places, rows = pressed_rows()
    for factor, words in ((1000.0, "times as large as those of the other loads"), (1e-4, "far below the noise")):
        odd = rows.copy()
        odd[7] *= factor
        result = analysed(pairs, table(tmp_path, odd), sensor, differences=True)
        assert max(errors_mm(result, places)) < 4
        (named,) = [warning for warning in result.warnings if "another unit" in warning]
        assert named.startswith("row 8: its ")
        assert words in named
    assert not [w for w in analysed(pairs, table(tmp_path, rows), sensor, differences=True).warnings if "unit" in w]


@pytest.mark.rest
@pytest.mark.parametrize("whole", [False, True])
def test_a_single_reading_in_another_unit_is_named_and_its_row_is_left_out(tmp_path, whole):
    pairs, sensor, places, rows = pressed_rows()
    rest = None
    if whole:
        unloaded = readings(sensor, pairs, places[:1], contrast=0.3)[1]
        rows, rest = rows + unloaded, table(tmp_path, np.tile(unloaded, (3, 1)))
    rows[7, 40] *= 1000
    result = analysed(pairs, table(tmp_path, rows), sensor, rest, differences=not whole)
    assert max(errors_mm(result, places)) < 4
    assert sorted(round(event.peak_s) for event in result.events) == [*range(7), *range(8, 12)]
    assert result.recording.rows_rejected == 1
    (named,) = [warning for warning in result.warnings if "another unit" in warning]
    assert named.startswith("row 8, column 40: about ")
    assert named.endswith("; the row is left out")


def test_a_single_press_among_rows_of_noise_is_in_no_other_unit(tmp_path):
    pairs, sensor, _, rows = pressed_rows()
    noise = 1e-3 * np.median(np.abs(rows)) * np.random.default_rng(7).standard_normal(rows.shape)
    noise[4] += rows[4]
    result = analysed(pairs, table(tmp_path, noise), sensor, differences=True)
    assert [round(event.peak_s) for event in result.events] == [4]
    assert not [warning for warning in result.warnings if "unit" in warning]
