"""Maps of stress: made even by the sensor's own response, on a simulated sheet that answers unevenly."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_runs import HEAD, simulated_run
from test_verification import observed

from cbsr_qa.analysis.evaluate import Conclusion, calibrate_run
from cbsr_qa.analysis.run.loads import load_window
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.calibration.runtime.pressure import PressureMap
from cbsr_qa.config.loader import load_scene_plan
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.domain.results.measurement import Verdict


def uneven():
    """The shipped base scene on a sheet whose response varies."""
    tables = dict(load_scene_plan("base").document.data)
    uneven_response = {"name": "uneven-response", "deviation": 0.25, "correlation_mm": 25.0}
    return {**tables, "effects": [uneven_response, *tables["effects"]]}


@pytest.fixture(scope="module")
def run():
    return observed(simulated_run(NINE_LOCATIONS_MM, scene=uneven(), seed=5), "grid")


@pytest.fixture(scope="module")
def calibration(run):
    observation, recipe = run
    conclusion = Conclusion(observation, (), Verdict(Outcome.PASS, "a test"), ())
    of_grid, issued_at = replace(recipe, calibrate_phases=("grid",)), "2026-01-02T00:00:00+00:00"
    issued, why = calibrate_run(conclusion, of_grid, calibration="c", issued_at=issued_at)
    assert issued is not None, why
    return Calibration(issued)


def steady(run):
    """Mean steady frame of each load."""
    phase, settings = run.record.phases[0], run.settings
    return np.array([load_window(phase, one.record, settings).steady.voltages.mean(axis=0) for one in run.loads])


@pytest.mark.rest
def test_equal_loads_look_equal_wherever_they_press(run, calibration):
    observation, _ = run
    pressure = PressureMap(calibration)
    stress = pressure.stress_kPa(steady(observation))
    plain = stress * pressure.baseline_conductance
    heads = [HEAD.footprint_at(x, y).contains(pressure.mesh.centroids_mm) for x, y in NINE_LOCATIONS_MM]
    even = np.array([values[head].mean() for values, head in zip(stress, heads, strict=True)])
    uneven_ = np.array([values[head].mean() for values, head in zip(plain, heads, strict=True)])
    spread = uneven_.std() / uneven_.mean()
    assert spread > 0.1
    assert even.std() / even.mean() < spread / 2
    # Of the head's own 26 kPa the image shows the mean over its region; a blurred head is fainter than it is.
    assert even.mean() == pytest.approx(np.mean([one.stress_kPa for one in observation.loads]), rel=0.35)


def test_frames_without_a_load_show_the_noise_floor_at_most(run, calibration):
    observation, _ = run
    pressure = PressureMap(calibration)
    stress = pressure.stress_kPa(observation.unloaded.voltages)
    assert (np.abs(stress) < 1.5 * pressure.floor_kPa).all()
    assert (pressure.floor_kPa > 0).all()


def test_a_frame_that_cannot_be_read_has_no_stress(calibration):
    reference = calibration.issued.reference
    found = PressureMap(calibration).stress_kPa(np.array([np.full_like(reference, np.nan), reference]))
    assert np.isnan(found[0]).all()
    assert np.isfinite(found[1]).all()


def test_without_a_location_there_is_no_map(calibration):
    bare = Calibration(
        replace(calibration.issued, baseline=tuple(replace(p, value=None) for p in calibration.issued.baseline))
    )
    with pytest.raises(CalibrationError, match="no location of calibration c relates"):
        PressureMap(bare)
