"""Metrics of a run as a whole: noise, reciprocity, contacts, the noise figure, and how the grid lies."""

import re
from dataclasses import replace

import numpy as np
import pytest
from observation_samples import sample_load, sample_run

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.readings.frames import FrameBlock, ReadingFlag, VoltageUnit
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa_plugins.metrics.contacts import ContactResistance, ReciprocityError
from cbsr_qa_plugins.metrics.images import RegistrationOfPlaces
from cbsr_qa_plugins.metrics.noise import ChannelNoise, ImageNoise, NoiseFigure

# --- of its readings and images ---------------------------------------------------------------------------


def test_image_noise_is_the_scatter_of_the_unloaded_images():
    run = sample_run(noise=1e-3, frames=400)
    floor, total, single = ImageNoise().measure_run(run)
    assert (floor.name, floor.value, floor.unit) == ("noise_floor", 0.005, "1")
    R, areas = run.reconstruction.matrix, run.reconstruction.problem.mesh.areas_mm2
    weights = areas / areas.sum()
    reading_noise = 1e-3 / run.scale
    assert total.value == pytest.approx(reading_noise * np.linalg.norm(weights @ R), rel=0.12)
    assert single.value == pytest.approx(reading_noise * np.sqrt(weights @ (R**2).sum(axis=1)), rel=0.12)
    assert single.qualifier == "per element"
    assert total.uncertainty == pytest.approx(total.value / np.sqrt(2 * 399))


def test_image_noise_of_one_frame_is_refused():
    _, total, single = ImageNoise().measure_run(sample_run(frames=1))
    assert total.value is single.value is None


def test_channel_snr_and_drift_come_apart():
    quiet = sample_run(noise=1e-3, frames=200)
    time_min = quiet.unloaded.time_s / 60
    drifting = quiet.unloaded.voltages + quiet.reference * 0.004 * (time_min - time_min.mean())[:, None, None]
    run = sample_run(unloaded=drifting)
    median, worst, drift = ChannelNoise().measure_run(run)
    expected = 20 * np.log10(run.reference[run.usable] / 1e-3)
    assert median.value == pytest.approx(np.median(expected), abs=0.6)
    assert worst.value == pytest.approx(expected.min(), abs=1.0)
    assert (drift.name, drift.unit) == ("drift", "%/min")
    assert drift.value == pytest.approx(0.4, abs=5 * drift.uncertainty)
    assert drift.uncertainty < 0.001


def test_channel_snr_finds_the_worst_channel():
    run = sample_run(noise=1e-3, frames=50)
    drive, measure = np.argwhere(run.usable)[3]
    spoilt = run.unloaded.voltages.copy()
    spoilt[:, drive, measure] += np.random.default_rng(8).standard_normal(50)
    _, worst, _ = ChannelNoise().measure_run(sample_run(unloaded=spoilt))
    assert worst.how == f"drive pair {drive}, measure pair {measure}"


def test_frames_without_noise_have_no_ratio():
    run = sample_run(noise=0.0)
    assert all(m.value is None for m in ChannelNoise().measure_run(run) if m.name == "channel_snr")
    (figure,) = NoiseFigure().measure_run(run)
    assert figure.value is None


def test_reciprocity():
    perfect, _ = ReciprocityError().measure_run(sample_run())
    assert perfect.value == pytest.approx(0.0, abs=1e-15)
    run = sample_run()
    skewed = run.reference * np.where(np.triu(np.ones_like(run.reference)) > 0, 1.01, 1.0)
    found, worst = ReciprocityError().measure_run(replace(run, reference=skewed))
    assert (found.name, found.unit) == ("reciprocity_error", "1")
    assert found.value == pytest.approx(0.01, rel=0.05)
    assert worst.qualifier == "worst"
    assert worst.value > found.value


def test_reciprocity_of_every_pair_names_the_readings():
    run = sample_run()
    skewed = run.reference.copy()
    drive, measure = np.argwhere(run.usable)[4]
    skewed[drive, measure] *= 1.1
    together, worst, *every = ReciprocityError(every=True).measure_run(replace(run, reference=skewed))
    assert len(every) == run.usable.sum() // 2
    assert sorted((drive, measure)) == [int(word) for word in re.findall(r"\d+", worst.how)]
    assert [m.qualifier for m in every if m.value > 1e-12] == [worst.how]
    assert together.value == pytest.approx(np.sqrt(np.mean([m.value**2 for m in every])))


def test_the_ratio_of_every_channel_is_its_own_measurement():
    run = sample_run(noise=1e-3, frames=50)
    median, worst, *every, drift = ChannelNoise(every=True).measure_run(run)
    assert len(every) == run.usable.sum()
    assert {m.unit for m in every} == {"dB"}
    assert median.value == pytest.approx(np.median([m.value for m in every]))
    assert worst.value == min(m.value for m in every)
    drive, measure = np.argwhere(run.usable)[0]
    assert every[0].qualifier == f"drive {drive}, measure {measure}"
    assert drift.name == "drift"


@pytest.mark.parametrize("metric", [ChannelNoise, ReciprocityError])
def test_every_is_true_or_false(metric):
    with pytest.raises(ConfigError, match="every is 'yes'"):
        metric(every="yes")


def test_reciprocity_of_a_pattern_without_reciprocal_pairs_is_refused():
    run = sample_run()
    pattern = DrivePattern(6, ((0, 1), (1, 2)), ((3, 4), (4, 5)))
    record = replace(run.record, sensor_type=replace(run.record.sensor_type, pattern=pattern))
    found, worst = ReciprocityError().measure_run(replace(run, record=record))
    assert found.value is worst.value is None
    assert "no imaged reading has a reciprocal one" in found.how


def test_reciprocity_of_pairs_that_are_driven_one_way_and_measured_the_other():
    run = sample_run()
    pattern = DrivePattern(6, ((0, 1), (4, 3)), ((1, 0), (3, 4), (2, 5)))
    record = replace(run.record, sensor_type=replace(run.record.sensor_type, pattern=pattern))
    reference = np.array([[5.0, 1.0, 0.3], [1.1, 5.0, 0.2]])
    usable = pattern.usable()
    found, _ = ReciprocityError().measure_run(replace(run, record=record, reference=reference, usable=usable))
    assert found.value == pytest.approx(0.1 / np.sqrt((1.0**2 + 1.1**2) / 2))


def test_contact_resistance_of_each_pair_and_together():
    run = sample_run(current_A=2e-3)
    *pairs, together, ratio = ContactResistance().measure_run(run)
    assert [pair.qualifier for pair in pairs] == [f"pair {k}-{(k + 1) % 6}" for k in range(6)]
    expected = np.diag(run.reference) / 2e-3
    assert [pair.value for pair in pairs] == pytest.approx(expected)
    assert (together.name, together.unit) == ("interelectrode_resistance", "Ω")
    assert together.value == pytest.approx(np.median(expected))
    assert together.uncertainty == pytest.approx(np.std(expected, ddof=1))
    assert ratio.value == pytest.approx(expected.max() / np.median(expected))
    assert pairs[int(expected.argmax())].qualifier in ratio.how


def test_a_pair_at_the_sources_limit_has_no_resistance():
    run = sample_run()
    flags = run.unloaded.flags.copy()
    flags[4, 2, 2] = ReadingFlag.COMPLIANCE
    spoilt = replace(run, unloaded=replace(run.unloaded, flags=flags))
    *pairs, together, ratio = ContactResistance().measure_run(spoilt)
    assert pairs[2].value is None
    assert "compliance" in pairs[2].how
    assert "1 without value" in together.how
    assert ratio.value is None


@pytest.mark.parametrize(
    ("options", "said"),
    [({"unit": VoltageUnit.COUNT}, "not in volts"), ({"current_A": None}, "current is not known")],
)
def test_contact_resistance_needs_volts_and_current(options, said):
    measured = ContactResistance().measure_run(sample_run(**options))
    assert all(m.value is None and said in m.how for m in measured)


def _figure_by_hand(run, signal: np.ndarray) -> float:
    AR = run.reconstruction.problem.mesh.areas_mm2[:, None] * run.reconstruction.matrix
    noise = np.sqrt((AR**2).sum() / len(AR))
    return float(np.abs(signal).mean() / np.abs(AR @ signal).mean() * noise)


def test_the_noise_figure_of_equal_noise_is_adlers():
    run = sample_run(noise=1e-3, frames=600)
    (figure,) = NoiseFigure().measure_run(run)
    distance = np.hypot(*run.reconstruction.problem.mesh.centroids_mm.T)
    target = (distance <= max(6.5, distance.min())).astype(float)
    assert figure.value == pytest.approx(_figure_by_hand(run, run.reconstruction.problem.jacobian @ target), rel=0.05)
    assert "central target" in figure.how


def test_the_noise_figure_takes_the_measured_press_at_the_centre():
    plain = sample_run(noise=1e-3, frames=600)
    change = 0.02 * np.random.default_rng(12).standard_normal(plain.reference.shape)
    held = np.repeat((plain.reference + change)[None], 30, axis=0)
    pressed = FrameBlock(100 + 2.0 * np.arange(30), held, np.zeros(held.shape, np.uint8), VoltageUnit.VOLT, 1e-3)
    loads = (sample_load("L0", phase="noise figure"), sample_load("L1", (30.0, 0.0), phase="nine locations"))
    run = sample_run(loads, noise=1e-3, frames=600, pressed=pressed)
    (figure,) = NoiseFigure().measure_run(run)
    assert figure.value == pytest.approx(_figure_by_hand(run, change[run.usable]), rel=0.05)
    assert figure.phase == "noise figure"
    assert "1 presses at the centre" in figure.how


def test_the_stated_error_of_the_noise_figure_is_that_seen():
    found = [NoiseFigure().measure_run(sample_run(noise=1e-3, frames=30, seed=3))[0]]
    rng = np.random.default_rng(99)
    base = sample_run()
    for _ in range(60):
        unloaded = base.reference + 1e-3 * rng.standard_normal((30, *base.reference.shape))
        found.append(NoiseFigure().measure_run(sample_run(unloaded=unloaded))[0])
    values = [m.value for m in found]
    assert np.std(values, ddof=1) == pytest.approx(np.mean([m.uncertainty for m in found]), rel=0.3)


# --- of the grid as a whole --------------------------------------------------------------------------------


def test_a_grid_that_is_seen_off_is_the_stations_and_the_rest_the_sensors():
    """Every place is seen 2 mm to the right, one of them 1 mm further up."""
    places = [(0.0, 0.0), (30.0, 0.0), (-30.0, 0.0), (0.0, 30.0), (0.0, -30.0)]
    loads = tuple(
        sample_load(f"L{k}", place, blob_mm=(place[0] + 2.0, place[1] + (k == 0), 6.5), index=k)
        for k, place in enumerate(places)
    )
    unseen = sample_load("L5", (15.0, 15.0), blob_mm=None, index=5)
    shift, rotation, scale, *each = RegistrationOfPlaces().measure_run(sample_run((*loads, unseen)))
    assert (shift.name, rotation.name, scale.name) == tuple(list(RegistrationOfPlaces.measures)[:3])
    assert shift.value == pytest.approx(np.hypot(2.0, 0.2), abs=1e-9)  # the one's millimetre is a fifth of all
    assert shift.uncertainty > 0
    assert (rotation.value, scale.value) == (pytest.approx(0, abs=1e-9), pytest.approx(1, abs=1e-9))
    assert [one.location for one in each] == ["L0", "L1", "L2", "L3", "L4", "L5"]
    assert [one.value for one in each[:5]] == pytest.approx([0.8, 0.2, 0.2, 0.2, 0.2], abs=1e-9)
    assert (each[5].value, each[5].how) == (None, "not detected")


def test_too_few_places_are_not_registered_with_the_reason():
    found = RegistrationOfPlaces().measure_run(sample_run((sample_load(),)))
    assert {one.name: one.value for one in found} == dict.fromkeys(RegistrationOfPlaces.measures)
    assert all(one.how for one in found)
