"""Defects of whole recordings that look like data, or hide what is there: each is named, and sound ones are not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from board_files import BoardFile
from test_what_is_no_load import (
    DISC,
    FRAMES,
    NOISE,
    OFFSET,
    RATE_HZ,
    USED,
    analysed,
    block,
    counts,
    made,
    press,
    with_dead_drive,
)
from tiers import rest_but

from cbsr_qa.analysis.defects.channels import find_faults
from cbsr_qa.analysis.recording.analysis import AnalysisChoices, analyse_recording
from cbsr_qa.analysis.recording.imaging import sheet_for, unit_model
from cbsr_qa.analysis.recording.places import find_places, matcher
from cbsr_qa.app.analyse.analyse import analyse_file
from cbsr_qa.app.analyse.request import AnalyseRequest
from cbsr_qa.domain.readings.frames import FrameBlock, ReadingFlag, ScanKind, VoltageUnit
from cbsr_qa.eit.forward.coverage import disc_coverage
from cbsr_qa.eit.inverse.problem import nominal_model
from cbsr_qa.eit.loads.local import LocalUpdate
from cbsr_qa_plugins.reconstruction.one_step import GaussNewtonNoser

_K = np.arange(FRAMES)


def analysed_file(tmp_path: Path, voltages):
    path = BoardFile(mass=False).header().frames(np.round(voltages)).save(tmp_path)
    return analyse_file(path, AnalyseRequest(report=False))


@pytest.mark.parametrize("factor", rest_but({1000}, [8, 257, 1000, 2**16]))
@pytest.mark.parametrize("value", [12345, 0])
def test_a_stuck_channel_among_counts_above_16_bits_is_named_and_costs_no_frame(tmp_path, factor, value):
    """Its value is no multiple of the factor: it was read behind what multiplies."""
    voltages = counts(press(0.4, 0.3, -60, 50, 90)) * factor
    voltages[:, 5, 9] = value
    found = analysed_file(tmp_path, voltages)
    assert (found.exit_code, found.recording.frames, found.recording.rows_rejected) == (0, FRAMES, 0)
    assert (5, 9) in found.channels.stuck
    assert any("[5, 9]" in warning and "left out" in warning for warning in found.warnings)
    assert len(found.events) == 1
    assert f"divided by {factor}" in found.recording.notes[0]


@pytest.mark.parametrize("frames", [(0, 8), (60, 160)])
def test_a_damaged_number_among_scaled_counts_still_costs_its_row(tmp_path, frames):
    voltages = counts() * 1000
    voltages[slice(*frames), 5, 9] += np.arange(frames[1] - frames[0]) + 1
    assert analysed_file(tmp_path, voltages).recording.rows_rejected == frames[1] - frames[0]


@pytest.mark.parametrize("drive", rest_but({5}, [0, 5, 15]))
@pytest.mark.parametrize("loads", [(), (press(0.4, 0.3, -60, 50, 90),)])
def test_a_drive_that_is_dead_below_the_offset_is_named(drive, loads):
    """The offset is divided too, so that one reading of every other drive has a reciprocal far away."""
    voltages = counts(*loads)
    voltages[:, drive] = np.round(voltages[:, drive] / 5)
    voltages[:, drive, drive] = 2**16 - 1000 + np.random.default_rng(drive).normal(0, NOISE, FRAMES).round()
    result = analysed(voltages)
    (said,) = (warning for warning in result.warnings if "is dead" in warning)
    assert said.startswith(f"drive pair {drive} is dead: its readings are 20% of those")
    assert "where 11000 is usual" in said
    assert len(result.events) == len(loads)
    assert result.channels.used == 208 - 13


@pytest.mark.rest
def test_two_dead_drives_are_both_named():
    voltages = with_dead_drive(counts(), 3, wrapped=True)
    voltages[:, 9] = np.round(voltages[:, 9] / 5)
    said = [warning for warning in analysed(voltages).warnings if "is dead" in warning]
    assert [warning.partition(" is")[0] for warning in said] == ["drive pair 3", "drive pair 9"]


@pytest.mark.parametrize("ends", [(-32767, 32767), (0, 65535), (1000, 20_000)])
@pytest.mark.parametrize("flips", [0.0, 0.05])
def test_two_levels_are_no_readings_of_a_sheet(tmp_path, ends, flips):
    """Cut at both ends throughout, or bits that look like data: saturated, not a frozen board without a reason."""
    random = np.random.default_rng(3)
    high = counts()[0] > OFFSET
    voltages = np.where(high ^ (random.random((40, 16, 16)) < flips), ends[1], ends[0])
    found = analysed_file(tmp_path, voltages)
    assert found.exit_code == 2
    assert len(found.channels.saturated) == 256
    assert f"all 256 readings are {ends[0]:g} or {ends[1]:g} count" in found.refused.reason


@pytest.mark.parametrize(
    ("level", "jitter", "saturated"), [(65535, 3, True), (65535, 20, True), (-32768, 6, True), (20_000, 20, False)]
)
def test_one_level_within_its_noise_is_a_ceiling_or_nothing_connected(tmp_path, level, jitter, saturated):
    random = np.random.default_rng(4)
    noise = random.integers(0, jitter + 1, (60, 16, 16))
    found = analysed_file(tmp_path, level - noise if level > 0 else level + noise)
    assert found.exit_code == 2
    assert (len(found.channels.saturated) == 256) is saturated
    assert found.channels.not_connected is not saturated


@pytest.mark.parametrize("unit", list(VoltageUnit))
def test_two_levels_with_noise_are_told_from_a_sheet_in_any_unit(unit):
    random = np.random.default_rng(5)
    high = np.random.default_rng(6).random((16, 16)) < 0.5
    times = np.arange(60) / RATE_HZ
    for voltages, is_two in ((np.where(high, 4000.0, 1000.0) + np.zeros((60, 1, 1)), True), (counts()[:60], False)):
        noisy = np.round(voltages + random.normal(0, 3, (60, 16, 16)))
        faults = find_faults(FrameBlock(times, noisy, np.zeros(noisy.shape, np.uint8), unit, None), ScanKind.FULL)
        assert faults.all_saturated is is_two
        assert not faults.not_connected


@pytest.mark.rest
@pytest.mark.parametrize("noise", [0.5, 20.0, 300.0, 1000.0])
def test_a_sheet_is_not_one_or_two_levels_however_noisy(noise):
    for seed in range(20):
        level = counts(seed=seed)[0]
        voltages = np.round(level + np.random.default_rng(seed).normal(0, noise, (FRAMES, 16, 16)))
        block = FrameBlock(_K / RATE_HZ, voltages, np.zeros(voltages.shape, np.uint8), VoltageUnit.COUNT, None)
        faults = find_faults(block, ScanKind.FULL)
        assert not faults.all_saturated
        assert not faults.not_connected


def relaxing(to, tau, release, *, residue=0.3, size=-60.0):
    """Press that relaxes to a share of its peak while it is held, and is released over some frames from 25 s on."""
    held = to + (1 - to) * np.exp(-np.maximum(_K - 40, 0) / tau)
    down, after = np.clip((_K - 100) / release, 0, 1), np.maximum(_K - 100 - release, 0)
    share = np.where(_K < 100, held, held[100] * (1 - down + down * residue * np.exp(-after / 100)))
    return press(0.4, 0.3, size, 40, FRAMES + 1, residue=0.0) * share[:, None, None]


@pytest.mark.parametrize("to", rest_but({0.6}, [0.8, 0.6, 0.4]))
@pytest.mark.parametrize("tau", rest_but({10}, [3, 10, 30, 100]))
@pytest.mark.parametrize("release", rest_but({1, 8}, [1, 4, 8]))
def test_a_load_that_relaxes_while_it_is_held_is_one_event_up_to_its_release(to, tau, release):
    (event,) = analysed(counts(relaxing(to, tau, release), seed=int(10 * to) + tau)).events
    assert event.start_s == pytest.approx(10, abs=0.5)
    assert 24.5 < event.end_s < 25.5 + release / RATE_HZ


@pytest.fixture(scope="module")
def sheet():
    """Changes of readings by loads at once, by the forward model, and the search for them."""
    model = LocalUpdate(nominal_model(DISC))
    empty = model.model.voltages()
    imaged = sheet_for(DISC, USED)
    unit = unit_model(empty[USED], imaged.problem, offset=False)
    sigma = 1e-4 * np.abs(empty).mean() * np.abs(unit.gain)
    match = matcher(imaged.patterns, imaged.places, np.maximum(sigma, 0.5 * np.median(sigma)), unit.nuisance)

    def found(loads, radius_mm, seed):
        covered = [disc_coverage(model.model.mesh, 50 * x, 50 * y, radius_mm) for x, y, _ in loads]
        elements = np.concatenate([elements for elements, _ in covered])
        contrast = np.concatenate([c * share for (_, share), (*_, c) in zip(covered, loads, strict=True)])
        noise = np.random.default_rng(seed).normal(0, 4e-5 * np.abs(empty).mean(), empty.shape)
        change = (model.voltages(elements, contrast) + noise)[USED]
        places, _ = find_places(match.whiten(unit.changes(change[None]))[0], match, noise=0.16)
        return np.array([(place.x, place.y) for place in places])

    return found


@pytest.mark.parametrize("share", [1.0, 0.5])
@pytest.mark.parametrize(
    "beside",
    [
        ((0.6, 0), (-0.6, 0)),
        pytest.param(((0.45, 0), (0, 0.45)), marks=pytest.mark.rest),
        pytest.param(((0.7, 0), (0, 0.7)), marks=pytest.mark.rest),
    ],
)
def test_a_load_at_the_centre_beside_two_others_is_found(sheet, share, beside):
    loads = [*((x, y, 0.3) for x, y in beside), (0.0, 0.0, 0.3 * share)]
    places = sheet(loads, 6.5, 1)
    assert len(places) == 3
    for x, y, _ in loads:
        assert np.hypot(*(places - (x, y)).T).min() < 0.13


@pytest.mark.parametrize("pair", rest_but({0.3}, [0.25, 0.3, 0.4]))
def test_two_loads_on_either_side_of_the_centre_are_not_one_between_them(sheet, pair):
    places = sheet([(pair, 0.0, 0.3), (-pair, 0.0, 0.3)], 6.5, 2)
    assert len(places) == 2
    assert np.abs(np.sort(places[:, 0]) - [-pair, pair]).max() < 0.1


@pytest.mark.rest
@pytest.mark.parametrize("radius_mm", [3.0, 6.5, 10.0, 15.0])
def test_one_load_of_any_size_and_place_is_one(sheet, radius_mm):
    for seed in range(30):
        random = np.random.default_rng([seed, int(radius_mm)])
        angle, r = random.uniform(0, 2 * np.pi), 0.8 * np.sqrt(random.uniform())
        load = (r * np.cos(angle), r * np.sin(angle), random.uniform(-0.3, 0.4))
        assert len(sheet([load], radius_mm, seed)) == 1


@pytest.mark.parametrize(("since", "words"), [(0, ""), (40, f" since {40 / RATE_HZ:.1f} s")])
def test_an_electrode_at_the_sources_limit_is_named_with_its_moment(since, words):
    """Both of its drive pairs are flagged, and only those: 2 × 13 readings that would be used."""
    flags = np.zeros((FRAMES, 16, 16), dtype=np.uint8)
    flags[since:, [11, 12]] = ReadingFlag.COMPLIANCE
    frames = replace(block(counts(press(0.4, 0.3, -60, 50, 90)), VoltageUnit.COUNT), flags=flags)
    result = analyse_recording(made(frames), GaussNewtonNoser(), AnalysisChoices())
    (said,) = (warning for warning in result.warnings if "may be open" in warning)
    assert said.startswith(f"electrode 12 may be open{words}: all readings driven through electrodes 11–12, 12–13")
    assert "(26 are saturated); check its pin" in said
    assert not any("stand at an end; they" in warning for warning in result.warnings if warning != said)
