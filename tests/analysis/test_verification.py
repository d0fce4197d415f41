"""A fielded sensor against its calibration: as it was, weaker than it was, and where it cannot be told."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_samples import INDENTER, LOAD_CELL
from simulated_runs import observed_run, simulated_run

from cbsr_qa.analysis.evaluate import Conclusion, calibrate_run
from cbsr_qa.analysis.run.force import run_force
from cbsr_qa.analysis.verification import compare_load_cells, verify_calibration
from cbsr_qa.app.run.preview import plan_run
from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.calibration.file.hdf5 import write_calibration
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.errors import CalibrationError, ConfigError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.domain.results.measurement import Verdict
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity
from cbsr_qa_plugins.metrics.calibration_check import CalibrationCheck

PLACES = ((0.0, 0.0), (25.0, 10.0), (-20.0, 18.0), (-8.0, -28.0))


def observed(record, *phases):
    return observed_run(record, calibrate_phases=phases), load_recipe("nine-locations").value


@pytest.fixture(scope="module")
def calibration():
    run, recipe = observed(simulated_run(NINE_LOCATIONS_MM, seed=3), "grid")
    conclusion = Conclusion(run, (), Verdict(Outcome.PASS, "a test"), ())
    issued, why = calibrate_run(
        conclusion,
        replace(recipe, calibrate_phases=("grid",)),
        calibration="c",
        issued_at="2026-01-02T00:00:00+00:00",
    )
    assert issued is not None, why
    assert run_force(run).learned is not None
    return Calibration(issued)


@pytest.fixture(scope="module")
def checked():
    """The same sensor in five minutes; a weaker one as well."""
    return {
        gauge: observed(simulated_run(PLACES, hold_s=15.0, rest_s=10.0, gauge=gauge, seed=8))[0]
        for gauge in (1.0, 0.8)
    }


@pytest.mark.rest
@pytest.mark.parametrize("gauge", [1.0, 0.8])
def test_sensitivity_is_found_from_holds_of_fifteen_seconds(calibration, checked, gauge):
    found = verify_calibration(checked[gauge], calibration)
    assert len(found.loads) == len(PLACES)
    assert abs(found.sensitivity / gauge - 1) < 0.05
    assert abs(found.sensitivity - gauge) < 4 * found.sensitivity_stderr
    assert found.sensitivity_stderr < 0.03
    assert found.noise_ratio == pytest.approx(1, abs=0.25)
    assert found.reference_change < 0.01


@pytest.mark.rest
def test_a_sheet_that_conducts_more_is_said_to_and_weighs_as_before(calibration, checked):
    run = checked[1.0]
    louder = replace(
        run, reference=run.reference * 1.001, unloaded=replace(run.unloaded, voltages=run.unloaded.voltages * 1.001)
    )
    assert verify_calibration(louder, calibration).reference_change == pytest.approx(1e-3, rel=0.5)


def test_load_cells_cancel_if_one_certificate_is_of_both():
    other = replace(LOAD_CELL, certificate="K-2027-9", uncertainty=1.2)
    shared, words = compare_load_cells((LOAD_CELL,), (LOAD_CELL, INDENTER))
    assert (shared, words.startswith("scatter only; certificate K-2026-0711 of the load cell is that of the")) == (
        (),
        True,
    )
    shared, words = compare_load_cells((LOAD_CELL,), (other,))
    assert [float(error.stderr_N(np.array([2.0]))[0]) for error in shared] == pytest.approx([0.005, 0.012])
    assert words.startswith("scatter and load cell of the calibration (U = 0.5 %")
    assert "and load cell of the run (U = 1.2 %" in words
    assert compare_load_cells((), ()) == ((), "scatter only; load cell of the calibration and of the run not stated")
    shared, words = compare_load_cells((LOAD_CELL,), ())
    assert len(shared) == 1
    assert words.endswith("; load cell of the run not stated")


@pytest.mark.rest
def test_another_load_cell_widens_what_is_compared(calibration, checked):
    """Two load cells of 3 and 4 % with k = 2 add 2.5 % to the sensitivity, and to each force."""
    cells = [replace(LOAD_CELL, uncertainty=3.0), replace(LOAD_CELL, certificate="other", uncertainty=4.0)]
    traced = Calibration(replace(calibration.issued, standards=(cells[0],)))
    bare = verify_calibration(checked[1.0], calibration)
    same = verify_calibration(replace(checked[1.0], standards=(cells[0],)), traced)
    found = verify_calibration(replace(checked[1.0], standards=(cells[1],)), traced)
    assert same.sensitivity_stderr == bare.sensitivity_stderr
    assert found.sensitivity == bare.sensitivity
    assert found.sensitivity_stderr == pytest.approx(np.hypot(bare.sensitivity_stderr, 0.025))
    for before, after in zip(bare.loads, found.loads, strict=True):
        assert after.stderr_N == pytest.approx(np.hypot(before.stderr_N, 0.025 * before.measured_N))


class TestRefused:
    def test_another_sensor(self, calibration, checked):
        run = checked[1.0]
        identity = replace(run.record.identity, sensor=SensorIdentity("T", "", "disc-100mm"))
        other = replace(run, record=replace(run.record, identity=identity))
        with pytest.raises(CalibrationError, match="is for sensor S, the run for T"):
            verify_calibration(other, calibration)

    def test_a_reading_that_is_gone(self, calibration, checked):
        run = checked[1.0]
        usable = run.usable.copy()
        usable[tuple(np.argwhere(usable)[0])] = False
        with pytest.raises(CalibrationError, match="1 readings that the calibration needs are no longer usable"):
            verify_calibration(replace(run, usable=usable), calibration)

    def test_no_force(self, calibration, checked):
        run = checked[1.0]
        loads = tuple(replace(load, force_N=None) for load in run.loads)
        with pytest.raises(CalibrationError, match="no load of the run was pressed alone"):
            verify_calibration(replace(run, loads=loads), calibration)


class TestMetric:
    def test_the_latest_file_of_the_serial_is_taken(self, calibration, checked, tmp_path, monkeypatch):
        monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path))
        run = "01a1ffeb-2239-72b2-8e32-52b0c09ce1b"
        for name in (f"S-{run}c", f"S-1-{run}d"):
            write_calibration(tmp_path / "calibrations" / f"{name}.h5", calibration.issued)
        found = {m.name: m for m in CalibrationCheck().measure_run(checked[0.8])}
        assert found["sensitivity_change"].value == pytest.approx(-20, abs=4)
        assert f"S-{run}c.h5" in found["sensitivity_change"].how
        assert set(found) == set(CalibrationCheck.measures)

    def test_without_a_file_nothing_has_a_value(self, checked, tmp_path, monkeypatch):
        monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path))
        for found in CalibrationCheck().measure_run(checked[1.0]):
            assert found.value is None
            assert "there is no calibration of sensor S" in found.how

    def test_a_file_that_is_none(self, checked, tmp_path):
        path = tmp_path / "broken.h5"
        path.write_bytes(b"no calibration")
        found = CalibrationCheck(calibration=str(path)).measure_run(checked[1.0])
        assert all(one.value is None and "broken.h5" in one.how for one in found)

    def test_a_file_that_is_not_there_is_refused(self):
        with pytest.raises(ConfigError, match=r"calibration is 'nowhere\.h5'"):
            CalibrationCheck(calibration="nowhere.h5")


def test_the_recipe_takes_five_minutes():
    dry = plan_run(RunRequest("simulated", "re-verification", "S")).dry
    assert dry.duration_s < 300
