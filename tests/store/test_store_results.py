"""Analyses and calibrations: added, never changed, and what a query finds is what was concluded."""

import sqlite3
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from calibration_samples import assert_same
from stored_runs import MATERIAL, calibration, journalled, reconstruction, short_run

from cbsr_qa.calibration.file import verify_calibration, write_calibration
from cbsr_qa.domain import CalibrationError, StoreError
from cbsr_qa.domain.results import (
    BaselineConductance,
    Bound,
    Limit,
    Measurement,
    Outcome,
    ParameterChoice,
    RunResult,
    Validity,
    Verdict,
)
from cbsr_qa.store import open_store

MEASURED = (
    Measurement("centre_of_mass_error", 1.2, "mm", 0.1, "nine locations", "L3", 0, "mask 85 %", "exact").judged(
        Limit("centre_of_mass_error", "mm", None, 6.5, 1.5, "nine locations", "mask 85 %")
    ),
    Measurement("area_overlap", None, "%", how="no blob").judged(Limit("area_overlap", "%", 50.0, None)),
    Measurement("noise_floor", 0.006, "1"),
)


@pytest.fixture
def repository(tmp_path):
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}") as opened:
        yield opened


@pytest.fixture
def run(repository):
    run = repository.new_id()
    journalled(repository, short_run(run))
    return run


def result(repository, run, outcome=Outcome.PASS, **changes):
    values = {
        "record": repository.load_run(run),
        "observation": None,
        "measurements": MEASURED,
        "verdict": Verdict(outcome, "all limits are met"),
        "calibration": None,
        "calibration_why": "not asked for",
        "compute_s": (("imaging", 0.25),),
        "warnings": ("first", "second"),
    }
    return RunResult(**(values | changes))


def test_an_analysis_comes_back_as_it_was_saved(repository, run):
    name = repository.save_result(result(repository, run), software=[("cbsr-qa", "9")])
    (back,) = repository.analyses(run)
    assert (back.analysis, back.run, back.software) == (name, run, (("cbsr-qa", "9"),))
    assert back.verdict == Verdict(Outcome.PASS, "all limits are met")
    assert back.measurements == MEASURED
    assert (back.warnings, back.compute_s) == (("first", "second"), (("imaging", 0.25),))
    assert (back.calibration, back.calibration_why) == (None, "not asked for")
    assert back.analysed_at.tzinfo is not None


def test_judging_again_adds_an_analysis_and_the_latest_holds(repository, run):
    first = repository.save_result(result(repository, run))
    before = repository.analyses(run)
    second = repository.save_result(result(repository, run, Outcome.FAIL, measurements=MEASURED[:1]))
    assert [a.analysis for a in repository.analyses(run)] == [second, first]
    assert repository.analyses(run)[1:] == before
    (summary,) = repository.find_runs("S-1")
    assert summary.outcome is Outcome.FAIL


def test_loads_of_one_label_and_trial_at_six_strains_stay_apart(repository, run):
    measured = tuple(
        Measurement("settling_time", 20.0 + k, "s", phase="campaign", location="L0", trial=0, bound=bound).judged(
            Limit("settling_time", "s", None, 23.0)
        )
        for k, bound in enumerate([Bound.EXACT, Bound.LOWER] * 3)
    )
    measured = tuple(replace(m, load=9 * k, strain=0.05 * (k + 1)) for k, m in enumerate(measured))
    repository.save_result(result(repository, run, measurements=measured))
    (back,) = repository.analyses(run)
    assert back.measurements == measured
    assert {(m.phase, m.load): m.strain for m in back.measurements} == {
        ("campaign", 9 * k): 0.05 * (k + 1) for k in range(6)
    }


def test_numpy_numbers_are_stored_as_plain_ones(repository, run):
    measured = Measurement("noise_floor", np.float64(0.5), "1", trial=np.int64(2))
    repository.save_result(result(repository, run, measurements=(measured,)))
    (back,) = repository.analyses(run)[0].measurements
    assert (back.value, back.trial) == (0.5, 2)
    assert type(back.trial) is int


@pytest.mark.rest
def test_a_calibration_comes_back_as_it_was_issued(repository, run):
    issued = calibration(repository.new_id(), run)
    repository.save_result(result(repository, run, calibration=issued, calibration_why=""))
    assert repository.analyses(run)[0].calibration == issued.calibration
    np.testing.assert_array_equal(repository.used_readings(issued.calibration), issued.reconstruction.problem.used)
    back = repository.load_calibration(issued.calibration, issued.reconstruction)
    assert_same(back, issued, "calibration")


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"relaxations": (), "size_ratio": None, "noise_figure": None, "settling": (), "overlap_bands": ()},
        {"against_stress": MATERIAL.against_stress, "validity": Validity(None, (0.2, 0.2), (20.5, 21.0), 0.0)},
        {"baseline": (BaselineConductance("L0", -0.0, 1 / 3, 0.1 + 0.2, 5e-324, 1),), "scale": -7.1},
    ],
)
def test_the_file_is_an_export_of_the_rows(repository, run, tmp_path, changes):
    issued = calibration(repository.new_id(), run, **changes)
    repository.save_result(result(repository, run, calibration=issued))
    at_issue = write_calibration(tmp_path / "issued.h5", issued)
    back = repository.load_calibration(issued.calibration, reconstruction())
    again = write_calibration(tmp_path / "exported.h5", back)
    assert at_issue == again == verify_calibration(tmp_path / "issued.h5").digest
    assert (tmp_path / "exported.h5").read_bytes() == (tmp_path / "issued.h5").read_bytes()
    with sqlite3.connect(tmp_path / "runs.db") as other:
        stored = other.execute("select content_sha256, record_sha256 from calibrations").fetchone()
    assert stored == (at_issue, verify_calibration(tmp_path / "exported.h5").record_digest)


def test_a_matrix_prepared_again_elsewhere_keeps_the_record_and_is_exported(repository, run, tmp_path):
    issued = calibration(repository.new_id(), run)
    repository.save_result(result(repository, run, calibration=issued))
    here = reconstruction()
    there = replace(
        here, matrix=np.nextafter(here.matrix, 2.0), choice=replace(here.choice, value=0.02 * (1 + 1e-9), how="again")
    )
    back = repository.load_calibration(issued.calibration, there)
    assert back.reconstruction.choice == issued.reconstruction.choice
    assert write_calibration(tmp_path / "exported.h5", back) != issued.digest
    assert verify_calibration(tmp_path / "exported.h5").record_digest == issued.record_digest


@pytest.mark.rest
@pytest.mark.parametrize(
    "edit",
    [
        "update calibration_baselines set value = 2.0 where number = 0",
        "update calibration_relaxations set amplitude_2 = -0.06 where number = 0",
        "delete from calibration_relaxations where number = 2",
        "update calibrations set stress_covariance = 0",
    ],
)
def test_edited_rows_are_not_exported(repository, run, tmp_path, edit):
    issued = calibration(repository.new_id(), run)
    repository.save_result(result(repository, run, calibration=issued))
    with sqlite3.connect(tmp_path / "runs.db") as other:
        assert other.execute(edit).rowcount == 1
    with pytest.raises(StoreError, match=r"calibration\w+ \(calibration .+\) was changed"):
        repository.load_calibration(issued.calibration, issued.reconstruction)
    with sqlite3.connect(tmp_path / "runs.db") as other:  # as a run of before chains
        other.execute("delete from run_links")
        other.execute("update runs set chain = null")
    back = repository.load_calibration(issued.calibration, issued.reconstruction)
    with pytest.raises(CalibrationError, match="not what was issued"):
        write_calibration(tmp_path / "exported.h5", back)


def test_a_calibration_that_was_never_issued_is_not_stored(repository, run):
    made = replace(calibration(repository.new_id(), run), digest="", record_digest="")
    with pytest.raises(StoreError, match="never issued"):
        repository.save_result(result(repository, run, calibration=made))
    assert repository.analyses(run) == ()


def test_what_was_assumed_is_flagged_parameter_by_parameter(repository, run, tmp_path):
    issued = calibration(repository.new_id(), run)
    repository.save_result(result(repository, run, calibration=issued))
    with sqlite3.connect(tmp_path / "runs.db") as other:
        rows = dict(other.execute("select name, assumed from calibration_parameters"))
    assert rows == {
        "against_stress.slope": 1,
        "against_stress.intercept": 1,
        "against_strain.slope": 0,
        "against_strain.intercept": 0,
    }


@pytest.mark.rest
def test_a_new_calibration_supersedes_only_the_same_sensors_earlier_ones(repository, run):
    other_run = repository.new_id()
    journalled(repository, short_run(other_run, "S-2"))
    names = [repository.new_id() for _ in range(4)]
    for name in names[:3]:
        repository.save_result(result(repository, run, calibration=calibration(name, run)))
    other = calibration(names[3], other_run, "S-2")
    repository.save_result(result(repository, other_run, calibration=other))
    held = {c.calibration: c.superseded_by for c in repository.calibrations("S-1")}
    assert held == {names[0]: names[1], names[1]: names[2], names[2]: None}
    assert [c.superseded_by for c in repository.calibrations("S-2")] == [None]


def test_a_number_that_is_not_finite_stores_nothing_at_all(repository, run):
    bad = calibration(repository.new_id(), run, scale=float("nan"))
    with pytest.raises(StoreError, match="not a finite number"):
        repository.save_result(result(repository, run, calibration=bad))
    assert repository.analyses(run) == ()
    assert repository.calibrations("S-1") == ()


def test_a_matrix_of_another_making_is_refused(repository, run):
    issued = calibration(repository.new_id(), run)
    repository.save_result(result(repository, run, calibration=issued))
    other = replace(reconstruction(), choice=ParameterChoice(0.5, "by hand", 2.0))
    with pytest.raises(StoreError, match=r"share kept = 0\.02, not with .* λ = 0\.5"):
        repository.load_calibration(issued.calibration, other)


def test_a_matrix_for_other_readings_is_refused(repository, run):
    issued = calibration(repository.new_id(), run)
    repository.save_result(result(repository, run, calibration=issued))
    whole = reconstruction()
    problem, fewer = whole.problem, whole.problem.used.copy()
    fewer[0, 2] = False
    less = replace(problem, used=fewer, jacobian=problem.jacobian[1:], reference=problem.reference[1:])
    with pytest.raises(StoreError, match="208 readings of a disc-100mm"):
        repository.load_calibration(issued.calibration, replace(whole, problem=less, matrix=whole.matrix[:, 1:]))


def test_a_result_of_a_run_that_is_not_stored_is_refused(repository, run):
    stranger = replace(repository.load_run(run).identity, run="unknown")
    record = replace(repository.load_run(run), identity=stranger)
    with pytest.raises(StoreError):
        repository.save_result(result(repository, run, record=record))


def test_runs_are_found_by_serial_and_by_name(repository, run):
    later = repository.new_id()
    journalled(repository, short_run(later))
    assert [r.run for r in repository.find_runs("S-1")] == [later, run]
    assert repository.find_runs("nobody") == ()
    assert repository.resolve("S-1") == later
    assert repository.resolve(run) == run
    with pytest.raises(StoreError, match="no run and no sensor"):
        repository.resolve("../../x")
    with pytest.raises(StoreError, match="there is no run"):
        repository.load_run("nothing")
    assert repository.counts() == {"sensors": 1, "runs": 2, "frames": 22, "samples": 80, "loads": 2}


def test_the_parameter_is_stored_under_its_own_name(repository, run, tmp_path):
    repository.save_result(result(repository, run, calibration=calibration(repository.new_id(), run)))
    with sqlite3.connect(tmp_path / "runs.db") as other:
        columns = "regularisation_name, regularisation_criterion, regularisation, regularisation_how"
        stored = other.execute(f"select {columns} from calibrations").fetchone()
    assert stored == ("share kept", "noise-figure", 0.02, "NF 1")


def test_the_analysis_says_how_readings_were_weighed(repository, run):
    plain = repository.save_result(result(repository, run))
    seen = SimpleNamespace(settings=SimpleNamespace(noise_weighting="measured"), weight_ratio=3.5)
    weighed = repository.save_result(result(repository, run, observation=seen))
    stored = {a.analysis: (a.noise_weighting, a.weight_ratio) for a in repository.analyses(run)}
    assert stored == {plain: ("", None), weighed: ("measured", 3.5)}


@pytest.mark.parametrize(("stored", "variance"), [("equal", np.ones(208)), ("measured", None)])
def test_a_matrix_with_other_weights_is_refused(repository, run, stored, variance):
    issued = calibration(repository.new_id(), run)
    seen = SimpleNamespace(settings=SimpleNamespace(noise_weighting=stored), weight_ratio=1.0)
    repository.save_result(result(repository, run, observation=seen, calibration=issued))
    other = replace(reconstruction(), problem=replace(reconstruction().problem, noise_variance=variance))
    with pytest.raises(StoreError, match=f"made with {stored} noise weighting"):
        repository.load_calibration(issued.calibration, other)
