"""Whole recordings with known presses, loose contacts, gains and glitches: what is called a load, and what is not."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiers import rest_but

from cbsr_qa.analysis.defects.channels import find_faults
from cbsr_qa.analysis.defects.noise import channel_noise
from cbsr_qa.analysis.recording.analysis import AnalysisChoices, analyse_recording
from cbsr_qa.analysis.recording.imaging import nominal_disc, sheet_for
from cbsr_qa.analysis.recording.repeats import average_repeats
from cbsr_qa.domain.readings.carry_over import CarryOver
from cbsr_qa.domain.readings.frames import FrameBlock, ReadingFlag, Recording, ScanKind, VoltageUnit
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.eit.forward.coverage import disc_coverage
from cbsr_qa.eit.inverse.problem import nominal_model
from cbsr_qa.eit.loads.local import LocalUpdate
from cbsr_qa_plugins.reconstruction.one_step import GaussNewtonNoser

DISC = nominal_disc(None, 16)
SHEET = sheet_for(DISC, DISC.pattern.usable())
USED = SHEET.problem.used
OFFSET, NOISE, RATE_HZ, FRAMES = 11_000.0, 20.0, 4.0, 160
LEVEL = np.zeros((16, 16))
LEVEL[USED] = SHEET.problem.reference * 2500 / np.abs(SHEET.problem.reference).max()


def press(x, y, size, begin, end, *, ramp=2, residue=0.3):
    """Change in counts, (frames, 16, 16); ``size`` over the noise of one frame, negative where it conducts less."""
    k = np.arange(FRAMES)
    up = np.clip((k - begin + 1) / max(ramp, 1), 0, 1)
    after = np.maximum(k - end, 0)
    kept = residue * np.exp(-after / 100) + (1 - residue) * np.exp(-after / 2)
    index = int(np.argmin(np.hypot(*(SHEET.places - (x, y)).T)))
    out = np.zeros((FRAMES, 16, 16))
    pattern = SHEET.patterns[:, index] / np.linalg.norm(SHEET.patterns[:, index])
    out[:, USED] = (size * NOISE * up * np.where(k >= end, kept, 1.0))[:, None] * pattern
    return out


def counts(*presses, seed=1, gain=None):
    rng = np.random.default_rng([23, seed])
    frames = LEVEL + sum(presses, np.zeros((FRAMES, 16, 16)))
    frames = frames if gain is None else frames * gain[:, None, None]
    return np.round(OFFSET + frames + rng.normal(0, NOISE, frames.shape))


def block(voltages, unit=VoltageUnit.COUNT):
    return FrameBlock(np.arange(len(voltages)) / RATE_HZ, voltages, np.zeros(voltages.shape, np.uint8), unit, None)


def analysed(voltages, unit=VoltageUnit.COUNT, sensor_type=None):
    choices = AnalysisChoices(sensor_type=sensor_type)
    return analyse_recording(made(block(voltages, unit)), GaussNewtonNoser(), choices)


def made(frames):
    return Recording(
        Path("made.csv"), "made", "", ScanKind.FULL, frames, None, still=False, magnitudes_only=False, clock="board"
    )


def loosened(voltages, electrode, begin, end=FRAMES):
    """Give the readings of the two pairs at an electrode nothing but offset and noise."""
    rng = np.random.default_rng([24, electrode])
    for pair in (electrode - 1, electrode):
        for at in (np.s_[begin:end, pair, :], np.s_[begin:end, :, pair]):
            voltages[at] = np.round(OFFSET + rng.normal(0, NOISE, voltages[at].shape))
    return voltages


@pytest.mark.parametrize("electrode", rest_but({5}, [3, 5, 11]))
@pytest.mark.parametrize("end", [FRAMES, 86])
def test_a_loose_electrode_is_named_and_is_no_load(electrode, end):
    result = analysed(loosened(counts(), electrode, 80, end))
    assert result.events == ()
    assert result.channels.suspect_electrodes == (electrode,)
    assert any(f"electrode {electrode}: its readings changed together at 20.0 s" in w for w in result.warnings)


def test_a_press_after_an_electrode_came_loose_is_still_found():
    result = analysed(loosened(counts(press(-0.4, 0.3, -30, 100, 130)), 13, 50))
    (event,) = result.events
    assert (event.start_s, event.end_s) == pytest.approx((25.0, 32.5), abs=0.8)
    assert np.hypot(event.x_over_R + 0.4, event.y_over_R - 0.3) < 0.15
    assert result.channels.suspect_electrodes == (13,)


@pytest.mark.parametrize(
    "missing",  # one, and neighbours, stay in make test
    [
        (3,),
        pytest.param((3, 8, 13), marks=pytest.mark.rest),
        (4, 5, 6, 7),
        pytest.param((2, 7, 8, 12), marks=pytest.mark.rest),
    ],
)
@pytest.mark.parametrize("begin", [0, 45])
def test_electrodes_without_contact_are_named_and_a_press_is_found_with_the_others(missing, begin):
    voltages = counts(press(-0.4, 0.3, -60, 100, 130))
    for electrode in missing:
        loosened(voltages, electrode, begin)
    result = analysed(voltages)
    assert result.channels.suspect_electrodes == missing
    (event,) = result.events
    assert np.hypot(event.x_over_R + 0.4, event.y_over_R - 0.3) < 0.2
    if len(missing) > 1:
        (said,) = (w for w in result.warnings if w.startswith(f"electrodes {', '.join(map(str, missing))} are open"))
        assert said.endswith("nothing comes through; check their pins; these readings were left out")
        assert ("are open since " in said) is bool(begin)
        assert any("times as uncertain as with all of them" in w for w in result.warnings)


@pytest.mark.parametrize("r", rest_but({0.88}, [0.7, 0.8, 0.88]))
@pytest.mark.parametrize("seed", rest_but({0}, range(3)))
def test_a_press_beside_an_electrode_is_no_loose_contact(r, seed):
    result = analysed(counts(press(0.0, r, -25, 60, 110), seed=seed))
    assert len(result.events) == 1
    assert result.channels.suspect_electrodes == ()


@pytest.mark.parametrize("grown", rest_but({-0.02, 0.3}, [-0.3, -0.02, 0.02, 0.05, 0.3]))
def test_a_step_of_the_gain_is_no_load_and_is_said(grown):
    result = analysed(counts(gain=1 + grown * (np.arange(FRAMES) >= 80)))
    assert result.events == ()
    assert any("in proportion" in w and "20.0 s" in w for w in result.warnings)


def test_a_gain_that_settles_is_no_load_and_a_press_before_a_step_of_it_stays():
    k = np.arange(FRAMES)
    assert analysed(counts(gain=1 + 0.05 * np.exp(-k / 8))).events == ()
    (event,) = analysed(counts(press(0.0, -0.5, -30, 40, 70), gain=1 + 0.05 * (k >= 110))).events
    assert (event.start_s, event.end_s) == pytest.approx((10.0, 17.5), abs=0.8)


@pytest.mark.rest
def test_a_press_at_the_centre_is_no_gain():
    for seed in range(4):
        (event,) = analysed(counts(press(0.0, 0.0, -25, 60, 110), seed=seed)).events
        assert event.r_over_R < 0.15


def with_dead_drive(voltages, drive, *, wrapped):
    """Let a fifth of the current reach the sheet from one drive pair; its own reading wraps, or does not."""
    k = np.arange(16)
    voltages[:, k, k] += 20_000
    voltages[:, drive] = np.round(OFFSET + (voltages[:, drive] - OFFSET) / 5)
    voltages[:, drive, drive] += -30_000 if wrapped else 16_000
    return voltages


@pytest.mark.parametrize("drive", rest_but({15}, [0, 6, 15]))
@pytest.mark.parametrize("wrapped", [True, False])
def test_a_dead_drive_is_named_and_left_out(drive, wrapped):
    result = analysed(with_dead_drive(counts(press(0.3, 0.4, -40, 60, 100)), drive, wrapped=wrapped))
    (said,) = (w for w in result.warnings if "is dead" in w)
    assert f"drive pair {drive} is dead" in said
    assert float(re.search(r"readings are (\d+)%", said).group(1)) == pytest.approx(20, abs=1)
    assert ("its own is" in said) == wrapped
    assert result.channels.used == 208 - 13
    (event,) = result.events
    assert np.hypot(event.x_over_R - 0.3, event.y_over_R - 0.4) < 0.1


@pytest.mark.parametrize(
    "fault",
    rest_but({"loud pair", "loose electrode"}, ["loud pair", "loose electrode", "none", "carry-over", "noise"]),
)
@pytest.mark.parametrize("seed", rest_but({0}, range(4)))
def test_no_other_fault_is_a_dead_drive(fault, seed):
    voltages = counts(press(0.3, 0.4, -40, 60, 100), seed=seed)
    if fault == "loud pair":
        voltages[:, :, 4] = OFFSET + 5 * (voltages[:, :, 4] - OFFSET)
    elif fault == "loose electrode":
        voltages = loosened(voltages, 5, 0)
    elif fault == "carry-over":
        voltages = np.round(voltages + 0.14 * (np.roll(voltages.reshape(-1), 1).reshape(voltages.shape) - voltages))
    elif fault == "noise":
        voltages = np.round(OFFSET + 40 * np.random.default_rng(seed).normal(size=voltages.shape))
    assert not any("is dead" in w for w in analysed(voltages).warnings)


OFFSETS = ((30, 300.0), (70, 500.0), (110, -300.0), (130, 60.0))


@pytest.mark.parametrize("unit", rest_but({VoltageUnit.COUNT}, [VoltageUnit.COUNT, VoltageUnit.VOLT]))
@pytest.mark.parametrize("loads", [(), (press(0.3, 0.4, -30, 50, 100),)])
def test_every_offset_on_all_readings_is_named_and_is_no_load(unit, loads):
    voltages = counts(*loads)
    for at, size in OFFSETS:
        voltages[at:] += size
    if unit is VoltageUnit.VOLT:
        voltages = 1e-5 * (voltages - OFFSET)
    result = analysed(voltages, unit)
    assert len(result.events) == len(loads)
    for event in result.events:
        assert (event.start_s, event.end_s) == pytest.approx((12.5, 25.0), abs=0.8)
        assert np.hypot(event.x_over_R - 0.3, event.y_over_R - 0.4) < 0.1
    (said,) = (w for w in result.warnings if "by one offset" in w)
    assert [float(at) for at in re.findall(r"at ([\d.]+) s", said)] == [at / RATE_HZ for at, _ in OFFSETS]
    scale = 1 if unit is VoltageUnit.COUNT else 1e-5
    sizes = [float(size) / scale for size in re.findall(r"([+-][\d.e-]+) (?:count|V) at", said)]
    assert sizes == pytest.approx([size for _, size in OFFSETS], abs=5)


@pytest.mark.parametrize("tau", rest_but({60}, [15, 60, 200]))
@pytest.mark.parametrize("seed", rest_but({0}, range(3)))
def test_a_press_that_fades_but_is_still_there_lasts_to_the_end(tau, seed):
    faded = np.where(np.arange(FRAMES) < 42, 1.0, 0.6 + 0.4 * np.exp(-(np.arange(FRAMES) - 42) / tau))
    held = press(0.3, 0.4, -40, 40, FRAMES + 1) * faded[:, None, None]
    (event,) = analysed(counts(held, seed=seed)).events
    assert (event.start_s, event.end_s) == pytest.approx((10.0, (FRAMES - 1) / RATE_HZ), abs=0.5)


@pytest.mark.parametrize("residue", rest_but({0.6}, [0.3, 0.6]))
@pytest.mark.parametrize("seed", rest_but({0}, range(3)))
def test_a_press_that_is_released_ends_though_the_sheet_keeps_most_of_it(residue, seed):
    (event,) = analysed(counts(press(0.3, 0.4, -40, 40, 90, residue=residue), seed=seed)).events
    assert event.end_s == pytest.approx(22.5, abs=0.8)


@pytest.mark.rest
def test_single_readings_that_jump_are_replaced_and_counted():
    for seed in range(6):
        voltages = counts(seed=seed)
        rng = np.random.default_rng([25, seed])
        hit = rng.random(voltages.shape) < 0.001
        voltages[hit] += rng.choice([-400, 400], hit.sum())
        result = analysed(voltages)
        assert result.events == ()
        assert result.noise.outliers == pytest.approx(hit[:, USED].mean(), rel=0.3)
        assert any("glitches" in w for w in result.warnings)


@pytest.mark.parametrize("value", rest_but({300}, [300, 2000, 32767]))
def test_one_absurd_reading_or_row_is_no_load(value):
    voltages = counts()
    voltages[80, 3, 7] += value
    assert analysed(voltages).events == ()
    voltages = counts()
    voltages[80, 4] += value
    assert analysed(voltages).events == ()


@pytest.mark.rest
def test_steady_noise_has_no_glitches():
    for seed in range(8):
        assert not any("glitches" in w for w in analysed(counts(seed=seed)).warnings)


@pytest.mark.rest
@pytest.mark.parametrize("frames", [1, 2, 3])
def test_a_press_of_a_few_frames_is_found_with_its_end(frames):
    for seed in range(4):
        true = press(0.4, -0.3, -45, 80, 80 + frames, ramp=0, residue=0.0)
        true[80 + frames :] = 0
        (event,) = analysed(counts(true, seed=seed)).events
        assert np.hypot(event.x_over_R - 0.4, event.y_over_R + 0.3) < 0.15
        assert event.start_s == pytest.approx(20.0, abs=0.5)
        assert event.end_s == pytest.approx(20.0 + frames / RATE_HZ, abs=0.6)


def test_loads_of_both_signs_after_each_other_each_have_their_own():
    result = analysed(counts(press(0.3, 0.4, -30, 30, 60), press(-0.3, -0.4, 30, 100, 130)))
    assert [event.sign for event in result.events] == [-1, 1]
    ends = [(event.start_s, event.end_s) for event in result.events]
    assert np.array(ends) == pytest.approx(np.array([(7.5, 15.0), (25.0, 32.5)]), abs=0.8)
    assert any("disagree about the sign" in w for w in result.warnings)


def test_loads_of_both_signs_at_once_are_two_events():
    result = analysed(counts(press(0.4, 0.3, -30, 60, 110), press(-0.4, -0.3, 25, 60, 110)))
    assert sorted(event.sign for event in result.events) == [-1, 1]


def test_a_load_held_from_the_beginning():
    held = press(0.0, 0.5, -30, -9, 60)
    alone = analysed(counts(held))
    assert any("held from the start" in w for w in alone.warnings)
    first, second = analysed(counts(held, press(0.1, -0.5, -30, 100, 130))).events
    assert (first.start_s, first.sign, second.sign) == (0.0, -1, -1)
    assert first.end_s == pytest.approx(15.0, abs=0.8)
    assert np.hypot(first.x_over_R, first.y_over_R - 0.5) < 0.15


def test_a_press_goes_on_while_another_begins_and_ends():
    result = analysed(counts(press(0.5, 0.0, -30, 30, 100), press(-0.4, 0.3, -30, 60, 130)))
    ends = [(event.start_s, event.end_s) for event in result.events]
    assert np.array(ends) == pytest.approx(np.array([(7.5, 25.0), (15.0, 32.5)]), abs=1.0)


@pytest.mark.parametrize("seed", rest_but({0}, range(3)))
def test_a_press_too_slow_to_be_a_step_is_known_by_its_release(seed):
    result = analysed(counts(press(0.2, -0.4, -30, 30, 120, ramp=60), seed=seed))
    (event,) = result.events
    assert event.sign == -1
    assert event.start_s == pytest.approx(7.5 + 0.2 * 15, abs=2.5)
    assert event.end_s == pytest.approx(30.0, abs=1.0)


def test_a_channel_that_stands_still_from_some_frame_on_is_stuck():
    voltages = counts()
    voltages[70:, 3, 8] = voltages[69, 3, 8]
    faults = find_faults(block(voltages), ScanKind.FULL)
    assert np.argwhere(faults.stuck).tolist() == [[3, 8]]
    assert faults.stuck_from[3, 8] == 69
    assert any("stuck after 17.2 s: channels [3, 8]" in w for w in analysed(voltages).warnings)


def test_quiet_channels_that_repeat_by_chance_are_not_stuck():
    for seed in range(20):
        voltages = np.round(np.random.default_rng([26, seed]).normal(0, 1, (200, 16, 16)) * [0.3] * 2 + [[3.0] * 16])
        voltages[:, :, 2:] += np.round(np.random.default_rng([27, seed]).normal(0, 20, (200, 16, 14)))
        assert not find_faults(block(voltages), ScanKind.FULL).stuck.any()


def test_a_frozen_board_is_called_that():
    result = analysed(np.repeat(counts()[:1], 100, axis=0))
    assert "identical" in result.events_why
    assert result.channels.saturated == ()


def test_one_far_channel_at_the_rail_says_nothing_of_the_driven_pairs():
    voltages = counts()
    k = np.arange(16)
    voltages[:, k, k] += 45_000
    voltages[:, 3, 8] = 65_535
    assert np.argwhere(find_faults(block(voltages), ScanKind.FULL).saturated).tolist() == [[3, 8]]


@pytest.mark.parametrize("sigma", [1.0, 2.0, 3.8, 5.0, 10.0])
def test_noise_of_counts_is_not_quantised(sigma):
    readings = np.round(np.random.default_rng(28).normal(300, sigma, (200, 208)))
    true = np.hypot(sigma, 1 / np.sqrt(12))
    assert np.median(channel_noise(readings, counts=True)) == pytest.approx(true, rel=0.06)


def test_a_correction_that_leaves_the_readings_hardly_reciprocal_is_not_worth_it():
    assert not CarryOver(0.006, 0.001, 1.62, 0.998).worth_correcting
    assert CarryOver(0.12, 0.001, 0.9, 0.51).worth_correcting


OPPOSITE = DrivePattern(16, tuple((k, (k + 8) % 16) for k in range(16)), tuple(((k + 1) % 16, k) for k in range(16)))


@pytest.mark.parametrize("unit", rest_but({VoltageUnit.COUNT}, [VoltageUnit.COUNT, VoltageUnit.VOLT]))
@pytest.mark.parametrize("share", rest_but({1.0, 0.0}, [1.0, 0.2, 0.0]))
def test_a_front_end_that_rectifies_is_named_and_its_dead_side_left_out(share, unit):
    """Negative voltages come through by a share; the offset of counts is added behind the front end."""
    sensor = replace(DISC, pattern=OPPOSITE)
    model = LocalUpdate(nominal_model(sensor))
    empty = model.model.voltages()
    elements, covered = disc_coverage(model.model.mesh, 15.0, 20.0, 7.5)
    loaded = model.voltages(elements, -0.3 * covered)
    held = (np.arange(FRAMES) // 50 == 1)[:, None, None]
    voltages = np.where(held, loaded, empty)
    voltages = 2500 / np.abs(empty[OPPOSITE.usable()]).max() * np.where(voltages < 0, share * voltages, voltages)
    voltages += np.random.default_rng([30, int(10 * share)]).normal(0, NOISE, voltages.shape)
    voltages = np.round(voltages + OFFSET) if unit is VoltageUnit.COUNT else 1e-5 * voltages
    result = analysed(voltages, unit, sensor)
    (event,) = result.events
    assert np.hypot(event.x_over_R - 0.3, event.y_over_R - 0.4) < 0.1
    said = [w for w in result.warnings if "the front end appears to rectify" in w]
    assert len(said) == (share < 1)
    assert all("96 readings whose modelled voltage is negative hardly respond" in w for w in said)


@pytest.mark.parametrize("times", rest_but({2}, [1, 2, 4]))
def test_repeated_injections_are_averaged_without_what_is_flagged(times):
    """The first eight drives are injected several times, the others once."""
    drives = np.concatenate([np.repeat(np.arange(8), times), np.arange(8, 16)])
    sensor = replace(
        DISC, pattern=DrivePattern(16, tuple(DISC.pattern.drive[k] for k in drives), DISC.pattern.measure)
    )
    voltages = counts(press(0.3, 0.4, -40, 60, 100))[:, drives]
    voltages = np.round(voltages + np.random.default_rng([31, times]).normal(0, 40, voltages.shape))
    flags = np.zeros(voltages.shape, np.uint8)
    if times > 1:
        flags[60:100, 0, 5], voltages[60:100, 0, 5] = ReadingFlag.MISSING, 0.0
    recording = made(replace(block(voltages), flags=flags))
    frames = average_repeats(recording, sensor)[0].frames
    assert frames.voltages.shape == (FRAMES, 16, 16)
    assert not frames.flags.any()
    first, others = (
        np.diff(frames.voltages[:50, rows], axis=0).std() / np.sqrt(2) for rows in (slice(8), slice(8, 16))
    )
    # The noise that all repeats share is in ``counts`` already.
    assert first**2 == pytest.approx(NOISE**2 + 40**2 / times, rel=0.06)
    assert others**2 == pytest.approx(NOISE**2 + 40**2, rel=0.06)
    (event,) = analyse_recording(recording, GaussNewtonNoser(), AnalysisChoices(sensor_type=sensor)).events
    assert np.hypot(event.x_over_R - 0.3, event.y_over_R - 0.4) < 0.15
