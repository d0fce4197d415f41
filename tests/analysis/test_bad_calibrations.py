"""Runs from which a calibration can be told in part, or not at all: refused, or issued with every reason."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_runs import observed_run, simulated_run

from cbsr_qa.analysis.evaluate import Conclusion, calibrate_run
from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.readings.frames import ReadingFlag
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.domain.results.measurement import Verdict
from cbsr_qa.domain.sensor.sensor_type import Parameter

_RECIPE = replace(load_recipe("nine-locations").value, calibrate_phases=("grid",))
_DEAD = 5


@pytest.fixture(scope="module")
def record():
    return simulated_run(NINE_LOCATIONS_MM)


@pytest.fixture(scope="module")
def whole(record):
    return _calibrated(record)


def _calibrated(record):
    observation = observed_run(record, over_time=False, calibrate_phases=("grid",))
    conclusion = Conclusion(observation, (), Verdict(Outcome.PASS, "all limits are met"), ())
    return calibrate_run(conclusion, _RECIPE, calibration="0193-c", issued_at="2026-01-01T00:00:00+00:00")


def _changed(record, **changes):
    return replace(record, phases=(replace(record.phases[0], **changes),))


def _of_loads(record, which):
    return _changed(record, loads=tuple(record.phases[0].loads[index] for index in which))


def _with_force(record, change):
    (force,) = record.phases[0].samples
    return _changed(record, samples=(replace(force, values=change(force)),))


def test_a_good_run_at_one_strain_says_that_its_intercept_is_assumed(whole):
    issued, why = whole
    assert why == ""
    (reason,) = issued.validity.reduced
    assert reason.startswith("all loads were pressed at one strain (20 %): the intercept")
    assert "β against stress" in issued.assumed
    assert issued.validity.radius_mm == 30.0


@pytest.mark.rest
def test_missing_places_are_a_reason_and_too_few_give_no_force(record, whole):
    issued, _ = _calibrated(_of_loads(record, range(4)))
    assert any(reason.startswith("force was learned at only 4 places") for reason in issued.validity.reduced)
    wide, full = issued.force.log_response_stderr, whole[0].force.log_response_stderr
    assert np.median(wide) > 1.5 * np.median(full)
    none, _ = _calibrated(_of_loads(record, range(2)))
    assert none.force is None
    assert none.no_force.startswith("2 of 2 loads determine the response of the sheet; 3 are needed")
    assert f"no force model: {none.no_force}" in none.validity.reduced


def test_a_load_cell_flat_at_its_limit_calibrates_nothing(record):
    (force,) = record.phases[0].samples
    held = [
        force.select_interval(load.hold_start_s, load.release_start_s).values.mean()
        for load in record.phases[0].loads
    ]
    issued, why = _calibrated(_with_force(record, lambda block: np.minimum(block.values, 0.5 * min(held))))
    assert issued is None
    assert "no load gives a baseline conductance: the load cell read" in why
    assert "saturated" in why


@pytest.mark.rest
def test_loads_of_a_load_cell_that_was_saturated_for_some_are_named(record):
    """A cell whose amplifier is stuck high during the second and third press."""
    stuck = [record.phases[0].loads[index] for index in (1, 2)]

    def change(block):
        values = block.values.copy()
        for load in stuck:
            values[(block.time_s >= load.press_start_s) & (block.time_s < load.release_start_s)] = 9.5
        return values

    issued, _ = _calibrated(_with_force(record, change))
    assert any("no force was measured of L1 at (30, 0) mm" in why for why in issued.validity.reduced)
    assert issued.validity.force_N[1] < 9.0
    assert issued.baseline[1].value is None


@pytest.mark.rest
def test_readings_of_a_dead_electrode_are_left_out_and_force_is_still_told(record, whole):
    pattern = record.sensor_type.pattern
    touching = (np.array(pattern.drive) == _DEAD).any(axis=1)[:, None]
    touching = touching | (np.array(pattern.measure) == _DEAD).any(axis=1)
    frames = record.phases[0].frames
    flags = frames.flags.copy()
    flags[:, touching] |= int(ReadingFlag.SATURATED)
    whole, _ = whole
    issued, why = _calibrated(_changed(record, frames=replace(frames, flags=flags)))
    assert why == ""
    assert any(reason.startswith(f"electrode {_DEAD} is dead") for reason in issued.validity.reduced)
    assert issued.force.merging.shape[1] < whole.force.merging.shape[1]
    load = record.phases[0].loads[0]
    hold = frames.select_interval(load.release_start_s - 8, load.release_start_s).voltages
    hold[:, touching] = np.nan
    seen = Calibration(issued).force(hold, place_mm=(load.load.x_mm, load.load.y_mm))
    assert not (seen.flags & Flag.UNREADABLE).any()
    both = Calibration(whole).force(frames.select_interval(load.release_start_s - 8, load.release_start_s).voltages)
    assert seen.force_N.mean() == pytest.approx(both.force_N.mean(), rel=0.05)


def test_a_line_that_is_not_clear_of_zero_gives_no_force(record):
    line = record.material.against_stress
    stress_kPa = 26.5
    crossing = replace(line, intercept=Parameter(-line.slope.value * stress_kPa, 5e-3, "a test"))
    issued, why = _calibrated(replace(record, material=replace(record.material, against_stress=crossing)))
    assert issued is None
    assert "clear of zero" in why or "sign" in why


def test_a_load_that_answers_the_other_way_is_named_and_left_out(record):
    """One press whose change is turned about the unloaded frame, as a swapped lead would."""
    load, frames = record.phases[0].loads[3], record.phases[0].frames
    during = (frames.time_s >= load.press_start_s) & (frames.time_s < load.rest_end_s)
    rested = frames.voltages[~during][:15].mean(axis=0)
    voltages = np.where(during[:, None, None], 2 * rested - frames.voltages, frames.voltages)
    issued, _ = _calibrated(_changed(record, frames=replace(frames, voltages=voltages)))
    assert any(
        why.startswith("no force was learned from L3 at (15, 15) mm, trial 0: it changed in the direction opposite")
        for why in issued.validity.reduced
    )
    assert issued.force is not None


@pytest.mark.rest
def test_loads_that_bear_a_model_out_widen_its_range(record):
    (phase,) = record.phases
    # L3 … L6 lie 21 mm from the centre, L1 and L2 30 mm.
    inner, outer = (
        tuple(replace(phase.loads[which], index=index) for index, which in enumerate(chosen))
        for chosen in ((0, 3, 4, 5, 6), (1, 2))
    )
    parts = (replace(phase, loads=inner), replace(phase, index=1, name="others", loads=outer))
    issued, _ = _calibrated(replace(record, phases=parts))
    assert issued.validity.radius_mm == 30.0
    assert (
        "force was learned up to 21.2 mm from the centre; loads up to 30 mm agree with it" in issued.validity.reduced
    )
    alone, _ = _calibrated(replace(record, phases=parts[:1]))
    assert alone.validity.radius_mm == pytest.approx(15 * 2**0.5)
