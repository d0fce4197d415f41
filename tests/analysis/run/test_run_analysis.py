"""A whole run's analysis against what the simulated world knows to be true."""

from dataclasses import replace
from datetime import timedelta
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from simulated_runs import HEAD, observed_run, recipes_method, simulated_run

from cbsr_qa.analysis.defects.load_cell import describe_zero_shift
from cbsr_qa.analysis.run.reference import usable_data
from cbsr_qa.config.loader import load_recipe, load_sensor_type
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.readings.frames import ReadingFlag
from cbsr_qa.domain.sensor.sensor_type import Response
from cbsr_qa.eit.imaging.shape import centre_of_mass_error_mm

_SETTINGS = load_recipe("nine-locations").value.analysis
_PLACES = ((0.0, 0.0), (30.0, 0.0), (-15.0, 15.0), (0.0, -30.0), (15.0, 15.0))


def _with_phase(record, **changes):
    return replace(record, phases=(replace(record.phases[0], **changes),))


def _errors_mm(observation):
    """How far from its press each load is seen."""
    for load in observation.loads:
        pressed = load.indenter.footprint_at(load.record.load.x_mm, load.record.load.y_mm)
        yield centre_of_mass_error_mm(load.mask(0.85).sensed, pressed)


@pytest.fixture(scope="module")
def run():
    return simulated_run(_PLACES)


@pytest.fixture(scope="module")
def observation(run):
    return observed_run(run)


def test_every_press_is_found_where_it_was(observation):
    assert max(_errors_mm(observation)) < 1.5


def test_force_is_the_relaxed_modulus_times_strain_and_area(run, observation):
    # At the end of a hold the stress has relaxed to within a percent (material file: slow time constant 15 s).
    expected = run.material.modulus_kPa.value * 0.2 * HEAD.area_mm2 * 1e-3
    for load in observation.loads:
        # The surface is found to about 0.01 mm of 0.8 mm.
        assert load.force_N == pytest.approx(expected, rel=0.03)
        assert load.stress_kPa == pytest.approx(load.force_N / HEAD.area_mm2 * 1e3)


@pytest.mark.rest
def test_response_is_decided_and_the_sign_of_the_material_changes_nothing_else(run, observation):
    assert observation.response is Response.INCREASE
    # Without noise the change of the readings is not quite odd in the conductance; small strain makes it so.
    pair = [observed_run(simulated_run(_PLACES[:2], strain=0.05, gauge=sign, noise=1e-7)) for sign in (1.0, -1.0)]
    assert [one.response for one in pair] == [Response.INCREASE, Response.DECREASE]
    for rising, falling in zip(pair[0].loads, pair[1].loads, strict=True):
        up, down = rising.image.values, falling.image.values
        assert np.abs(up + down).max() < 0.05 * np.abs(up).max()
        assert falling.mask(0.85).sensed is not None


@pytest.mark.rest
def test_residue_of_earlier_loads_is_seen_and_both_references_reported(observation):
    quick = observed_run(simulated_run(((15.0, 15.0), (15.0, 12.0)), hold_s=60.0, rest_s=5.0))
    first, second = quick.loads
    assert first.alternate is None
    assert second.residue > quick.noise_floor
    assert second.alternate is not None
    assert "both references" in " ".join(quick.warnings)
    # Against the frames before the press the residue is gone from the image, so its peak is lower.
    assert second.alternate.image.values.max() < second.image.values.max()
    other = observed_run(simulated_run(((15.0, 15.0), (15.0, 12.0)), hold_s=60.0, rest_s=5.0), reference="load")
    np.testing.assert_array_equal(other.loads[1].image.values, second.alternate.image.values)


def test_settling_is_the_materials_within_its_uncertainty(run, observation):
    kernel = run.material.loading_relaxation
    time_s = np.linspace(0, 60, 6001)
    deviation = sum(w * np.exp(-time_s / tau) for w, tau in zip(kernel.weights, kernel.time_constants_s, strict=True))
    true_s = time_s[np.flatnonzero(np.abs(deviation) > 0.15)[-1]]
    times = [
        seen.settling.value_s
        for load in observation.loads
        for seen in load.relaxations
        if seen.signal == "conductance" and seen.loading and seen.settling.value_s is not None
    ]
    assert len(times) >= 3
    # One exponential over two settling times of data underestimates the slow one: the mean is low, not far.
    assert 0.6 * true_s < np.mean(times) < 1.2 * true_s


def test_without_what_happens_over_time_all_else_is_the_same(run, observation):
    steady = observed_run(run, over_time=False)
    assert steady.noise_floor == observation.noise_floor
    for one, other in zip(steady.loads, observation.loads, strict=True):
        np.testing.assert_array_equal(one.image.values, other.image.values)
        assert (one.force_N, one.force_stderr_N, one.residue) == (other.force_N, other.force_stderr_N, other.residue)
        assert one.settled is None
        assert not one.relaxations
    assert not any("settl" in words for words in steady.warnings)


def test_flagged_and_stuck_readings_are_left_out_and_named(run):
    frames = run.phases[0].frames
    flags, voltages = frames.flags.copy(), frames.voltages.copy()
    flags[::3, 0, 7] = ReadingFlag.SATURATED
    voltages[:, 3, 9] = 0.25
    damaged = _with_phase(run, frames=replace(frames, flags=flags, voltages=voltages))
    observation = observed_run(damaged, over_time=False)
    assert not observation.usable[0, 7]
    assert not observation.usable[3, 9]
    assert observation.usable.sum() == 206
    said = " ".join(observation.warnings)
    assert "drive 0 measure 7" in said
    assert "drive 3 measure 9" in said
    assert max(_errors_mm(observation)) < 2.0


def test_faults_that_recordings_are_rid_of_are_named_and_left_out_of_runs_too(run, observation):
    frames, pattern = run.phases[0].frames, run.sensor_type.pattern
    random = np.random.default_rng(8)
    noise = random.normal(0, 1e-7, frames.voltages.shape)
    voltages = np.where(pattern.touching([7]), noise, frames.voltages)
    voltages[:, 2] /= 5
    spikes = (random.random(voltages.shape) < 2e-4) & (frames.time_s > frames.time_s[8])[:, None, None]
    voltages[spikes] += 0.5
    seen = observed_run(_with_phase(run, frames=replace(frames, voltages=voltages)), over_time=False)
    said = " ".join(seen.warnings)
    assert "electrode 7 is open: nothing comes through; check its pin" in said
    assert "drive pair 2 is dead" in said
    assert "check row 2 of the board and its leads" in said
    assert "their reciprocals did not" in said
    assert "images are made without electrode 7" in said
    assert seen.usable.sum() == 156 - 11
    assert max(_errors_mm(seen)) < 4.0
    assert not any(word in " ".join(observation.warnings) for word in ("contact", "dead", "reciprocals", "stuck"))


@pytest.mark.parametrize("simulated", [(), ("the sheet",)])
def test_an_electrode_that_opened_during_the_run_has_its_time(run, simulated, in_zurich):
    frames, pattern = run.phases[0].frames, run.sensor_type.pattern
    noise = np.random.default_rng(8).normal(0, 1e-7, frames.voltages.shape)
    opened_at = len(frames) // 3
    late = pattern.touching([7]) & (np.arange(len(frames)) >= opened_at)[:, None, None]
    damaged = _with_phase(run, frames=replace(frames, voltages=np.where(late, noise, frames.voltages)))
    damaged = replace(damaged, identity=replace(damaged.identity, simulated=simulated))
    (said,) = [words for words in usable_data(damaged).warnings if "is open" in words]
    time_s = frames.time_s[opened_at]
    at = damaged.identity.started_at + timedelta(seconds=float(time_s))
    local = at.astimezone(ZoneInfo("Europe/Zurich"))
    when = f"minute {time_s / 60:.1f} of the run" if simulated else f"{local:%Y-%m-%d %H:%M} CET"
    assert said == f"electrode 7 is open since {when}: nothing comes through; check its pin"


def test_a_row_whose_readings_never_change_is_dead(run):
    frames = run.phases[0].frames
    voltages = frames.voltages.copy()
    voltages[:, 3] = voltages[0, 3]
    said = usable_data(_with_phase(run, frames=replace(frames, voltages=voltages))).warnings
    assert said[0] == "row 3 of the board is dead: its readings never change; check its channel and its leads"
    assert not any("stuck at one value" in words for words in said)


def test_a_load_cell_whose_zero_moved_is_named(run):
    phase = run.phases[0]
    force, (first, *_, last) = phase.channel("force"), phase.loads
    assert describe_zero_shift(force, phase.loads) == ""
    moved = force.values + 0.4 * (force.time_s > first.rest_end_s)
    said = describe_zero_shift(replace(force, values=moved), phase.loads)
    names = f"from press {first.load.label} to press {last.load.label}"
    assert said == f"the load cell's zero moved by 0.4 N {names}: tare it, and check its mount and cable"
    assert describe_zero_shift(replace(force, values=moved), phase.loads[:1]) == ""
    assert describe_zero_shift(None, phase.loads) == ""


def test_a_lost_frame_costs_that_frame_and_nothing_else(run, observation):
    frames = run.phases[0].frames
    flags, voltages = frames.flags.copy(), frames.voltages.copy()
    held = int(np.flatnonzero(frames.time_s > run.phases[0].loads[1].hold_start_s)[3])
    flags[held], voltages[held] = ReadingFlag.MISSING, 0.0  # a whole frame
    flags[held + 30, 4], voltages[held + 30, 4] = ReadingFlag.MISSING, 0.0  # one row of another
    seen = observed_run(_with_phase(run, frames=replace(frames, flags=flags, voltages=voltages)), over_time=False)
    assert seen.usable.sum() == 208
    assert "2 of" in " ".join(seen.warnings)
    for load, before in zip(seen.loads, observation.loads, strict=True):
        np.testing.assert_allclose(load.image.values, before.image.values, atol=1e-12)


def test_a_reading_that_saturates_during_one_press_is_left_out_and_the_press_kept(run):
    frames = run.phases[0].frames
    press = run.phases[0].loads[2]
    flags = frames.flags.copy()
    flags[(frames.time_s >= press.press_start_s) & (frames.time_s < press.rest_end_s), 6, 1] = ReadingFlag.COMPLIANCE
    seen = observed_run(_with_phase(run, frames=replace(frames, flags=flags)), over_time=False)
    assert not seen.usable[6, 1]
    assert seen.usable.sum() == 207
    assert seen.loads[2].steady_frames == _SETTINGS.steady_frames


def test_lambda_belongs_to_the_sensor_type_not_to_the_sensor(run, observation):
    frames = run.phases[0].frames
    flags = frames.flags.copy()
    flags[:, 5, 9] = flags[:, 9, 5] = ReadingFlag.SATURATED
    seen = observed_run(_with_phase(run, frames=replace(frames, flags=flags)), over_time=False)
    assert seen.usable.sum() == 206
    assert seen.reconstruction.choice.value == observation.reconstruction.choice.value
    assert seen.reconstruction.choice.noise_figure != observation.reconstruction.choice.noise_figure


def test_driven_pairs_do_not_reach_the_image(run, observation):
    frames = run.phases[0].frames
    voltages = frames.voltages.copy()
    voltages[:, ~run.sensor_type.pattern.usable()] = 123.0
    changed = observed_run(_with_phase(run, frames=replace(frames, voltages=voltages)), over_time=False)
    np.testing.assert_array_equal(changed.loads[0].image.values, observation.loads[0].image.values)


def test_the_analysis_repeats_itself_to_the_bit(run, observation):
    recipes_method.cache_clear()
    again = observed_run(run)
    for one, other in zip(observation.loads, again.loads, strict=True):
        np.testing.assert_array_equal(one.image.values, other.image.values)


def test_a_sheet_that_does_not_respond_has_no_blob_and_no_response():
    observation = observed_run(simulated_run(_PLACES[:1], gauge=0.0))
    (load,) = observation.loads
    assert "not decided" in observation.response_how
    assert load.image.values.max() < 2 * observation.noise_floor
    # The steady image averages four frames, so its noise stays below the floor of single ones.
    assert all(view.sensed is None for view in load.masks)
    assert load.settled is None


def test_a_run_without_unloaded_frames_is_refused(run):
    with pytest.raises(NumericsError, match="no frames of the unloaded sheet"):
        observed_run(_with_phase(run, unloaded_from_s=None))


def test_too_few_unloaded_frames_are_refused(run):
    with pytest.raises(NumericsError, match="the reference at least one more"):
        observed_run(run, noise_floor_frames=20)


def test_an_offset_on_all_readings_is_named_with_its_time_and_taken_out_of_a_run(run, observation):
    frames = run.phases[0].frames
    at = int(np.flatnonzero(frames.time_s > run.phases[0].loads[2].hold_start_s)[5])
    voltages = frames.voltages.copy()
    voltages[at:] += 0.05
    seen = observed_run(_with_phase(run, frames=replace(frames, voltages=voltages)), over_time=False)
    said = (
        f"all readings changed by one offset, not by a load: +0.05 V at {frames.time_s[at]:.1f} s; it was taken out"
    )
    assert said in seen.warnings
    assert "offset" not in " ".join(observation.warnings)
    # Forces are learned from the record's frames.
    np.testing.assert_allclose(seen.record.phases[0].frames.voltages, frames.voltages, atol=2e-4)
    for load, before in zip(seen.loads, observation.loads, strict=True):
        np.testing.assert_allclose(
            load.image.values, before.image.values, atol=0.05 * np.abs(before.image.values).max()
        )


@pytest.mark.rest
def test_a_rectifying_front_end_is_named_and_its_dead_polarity_left_out_of_a_run():
    sensor = load_sensor_type("disc-100mm").value
    count = sensor.electrodes.count
    opposite = tuple((k, (k + count // 2) % count) for k in range(count))
    sensor = replace(sensor, pattern=replace(sensor.pattern, drive=opposite))
    pressed = simulated_run(_PLACES[:3], sensor=sensor)
    frames = pressed.phases[0].frames
    voltages = np.where(frames.voltages < 0, frames.voltages / 30, frames.voltages)
    seen = observed_run(_with_phase(pressed, frames=replace(frames, voltages=voltages)), over_time=False)
    (said,) = [words for words in seen.warnings if "rectify" in words]
    assert "modelled voltage is negative hardly respond" in said
    assert "left out" in said
    assert not (seen.usable & (frames.voltages.mean(axis=0) < 0)).any()
    assert max(_errors_mm(seen)) < 8.0
    assert not any("rectify" in words for words in observed_run(pressed, over_time=False).warnings)
