import numpy as np
import pytest

from cbsr_qa.analysis.defects.channels import find_faults
from cbsr_qa.analysis.defects.noise import channel_noise, find_steps, noise_report
from cbsr_qa.domain.readings.frames import FrameBlock, ReadingFlag, ScanKind, VoltageUnit


def block(voltages, flags=None, unit=VoltageUnit.COUNT, rate=4.0):
    voltages = np.asarray(voltages, dtype=float)
    flags = np.zeros(voltages.shape, np.uint8) if flags is None else flags
    return FrameBlock(np.arange(len(voltages)) / rate, voltages, flags, unit, None)


def scan(frames=60, seed=1, noise=30.0):
    rng = np.random.default_rng(seed)
    level = 7500 + 13000 * np.exp(-np.abs(np.subtract.outer(np.arange(16), np.arange(16))) / 1.5)
    return np.round(level + rng.normal(0, noise, (frames, 16, 16)))


def pairs(mask):
    return {tuple(int(k) for k in at) for at in np.argwhere(mask)}


def test_a_healthy_recording_has_no_faults():
    for seed in range(20):
        faults = find_faults(block(scan(seed=seed)), ScanKind.FULL)
        assert not faults.bad.any()
        assert not faults.not_connected


def test_a_channel_at_the_rail_and_a_stuck_one_are_told_apart():
    voltages = scan()
    voltages[:, 3, 3] = 65535
    voltages[:, 5, 9] = 8000
    faults = find_faults(block(voltages), ScanKind.FULL)
    assert pairs(faults.saturated) == {(3, 3)}
    assert pairs(faults.stuck) == {(3, 3), (5, 9)}


def test_clipped_readings_that_show_a_share_of_the_one_before_are_seen_through():
    """Driven pairs clipped at 4600 but read with 11 % memory never sit at the rail, except the first."""
    voltages, k = scan(), np.arange(16)
    previous = np.roll(voltages.reshape(len(voltages), -1), 1, axis=1).reshape(voltages.shape)
    voltages[:, k, k] = np.round(4600 + 0.11 * (previous[:, k, k] - 4600))
    voltages[:, 0, 0] = 4600
    faults = find_faults(block(voltages), ScanKind.FULL)
    assert pairs(faults.saturated) == {(i, i) for i in range(16)}


def test_flags_of_the_format_count():
    flags = np.zeros((60, 16, 16), np.uint8)
    flags[:30, 2, 2], flags[:, 4, 4] = ReadingFlag.COMPLIANCE, ReadingFlag.MISSING
    faults = find_faults(block(scan(), flags), ScanKind.FULL)
    assert pairs(faults.saturated) == {(2, 2)}
    assert pairs(faults.missing) == {(4, 4)}


@pytest.mark.parametrize("wobble", [0, 1])
def test_nothing_connected(wobble):
    rng = np.random.default_rng(1)
    voltages = 32534 + rng.integers(0, wobble + 1, (50, 1, 16))
    assert find_faults(block(voltages), ScanKind.DRIVEN_PAIRS).not_connected


def test_quiet_counts_that_seldom_change_are_not_stuck():
    voltages = np.round(
        300 + np.arange(256).reshape(16, 16) % 7 + np.random.default_rng(1).normal(0, 0.2, (30, 16, 16))
    )
    assert not find_faults(block(voltages), ScanKind.FULL).stuck.any()


def ring(seed, *, ceiling=np.inf):
    """One-row scans of a ring of resistors: pairs 1 to 3 low, some readings 2 % too high, as on the lab's rig."""
    rng = np.random.default_rng(seed)
    level = np.where(np.isin(np.arange(16), (1, 2, 3)), 4100.0, 66_000.0 + 300 * rng.normal(size=16))
    rows = level + rng.normal(0, 5, (800, 16))
    rows[rng.random(rows.shape) < 0.03] *= 1.022
    rows = np.minimum(rows, ceiling) + rng.normal(0, 4, rows.shape)
    return np.round(rows)[:, None]


def test_a_source_at_its_limit_is_seen_by_the_common_ceiling():
    for seed in range(5):
        faults = find_faults(block(ring(seed, ceiling=40_395)), ScanKind.DRIVEN_PAIRS)
        assert pairs(faults.saturated) == {(0, j) for j in range(16) if j not in (1, 2, 3)}
        assert not find_faults(block(ring(seed)), ScanKind.DRIVEN_PAIRS).saturated.any()


@pytest.mark.parametrize("ceiling", [3_000, 40_395])
def test_a_recording_is_saturated_only_if_every_pair_is_at_its_ceiling(ceiling):
    faults = find_faults(block(ring(1, ceiling=ceiling)), ScanKind.DRIVEN_PAIRS)
    assert faults.all_saturated == (ceiling == 3_000)


@pytest.mark.parametrize(("level", "saturated"), [(65_535, True), (-32_768, True), (32_534, False), (0, False)])
@pytest.mark.parametrize("scan_kind", [ScanKind.FULL, ScanKind.DRIVEN_PAIRS])
def test_silence_at_the_converters_end_is_saturation_and_elsewhere_no_connection(level, saturated, scan_kind):
    voltages = np.full((50, 16 if scan_kind is ScanKind.FULL else 1, 16), float(level))
    faults = find_faults(block(voltages), scan_kind)
    assert (faults.all_saturated, faults.not_connected) == (saturated, not saturated)


def test_channels_that_hardly_vary_are_stuck_and_quiet_drives_are_not():
    for seed in range(5):
        voltages = scan(seed=seed)
        jitter = np.random.default_rng(seed).integers(0, 2, (2, len(voltages)))
        voltages[:, 5, 9], voltages[:, 12, 2] = 8000 + jitter
        voltages[:, 7] = np.round(voltages[:, 7].mean(axis=0) + np.random.default_rng(seed).normal(0, 1, (60, 16)))
        assert pairs(find_faults(block(voltages), ScanKind.FULL).stuck) == {(5, 9), (12, 2)}


def test_noise_is_estimated_through_steps_outliers_and_drift():
    rng = np.random.default_rng(2)
    readings = 1e4 + rng.normal(0, 6, (400, 50)) + np.linspace(0, 3000, 400)[:, None]
    readings[200:] += 5800
    readings[rng.random(readings.shape) < 0.03] += 200
    assert np.median(channel_noise(readings, counts=False)) == pytest.approx(6, rel=0.15)


def test_a_level_step_is_reported_and_noise_is_taken_from_one_side():
    rng = np.random.default_rng(3)
    voltages = 44_000 + rng.normal(0, 5.7, (287, 1, 16))
    voltages[94:] += 5800
    recording = block(voltages, rate=54.0)
    readings = recording.voltages.reshape(287, 16)
    steps = find_steps(recording.time_s, readings, channel_noise(readings, counts=True))
    assert [step.what for step in steps] == ["level"]
    assert 93 / 54 < steps[0].time_s < 94 / 54
    assert steps[0].after - steps[0].before == pytest.approx(5800, rel=0.01)
    report = noise_report(recording, np.ones((1, 16), bool), steps, (), timed=True)
    assert report.rms == pytest.approx(5.7, rel=0.1)
    assert report.frames == 193


def test_bimodal_noise_is_reported_as_steps():
    rng = np.random.default_rng(4)
    size = np.where(np.arange(600) // 150 % 2 == 0, 40.0, 5.0)
    voltages = rng.normal(0, 1, (600, 16, 16)) * size[:, None, None]
    recording = block(voltages, unit=VoltageUnit.VOLT)
    readings = recording.voltages.reshape(600, 256)
    steps = find_steps(recording.time_s, readings, channel_noise(readings, counts=False))
    assert [round(step.time_s * 4) for step in steps] == pytest.approx([150, 300, 450], abs=2)
    assert [step.after for step in steps] == pytest.approx([5, 40, 5], rel=0.1)


def test_steady_noise_has_no_steps():
    for seed in range(30):
        readings = np.random.default_rng(seed).normal(0, 4, (200, 208))
        assert find_steps(np.arange(200.0), readings, channel_noise(readings, counts=False)) == ()
