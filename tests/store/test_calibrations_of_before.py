"""Calibrations that programs up to schema 0011 stored as rows are still put together, and refused where changed."""

import sqlite3
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from calibration_samples import assert_same, sample_force
from calibrations_of_before import store_as_rows
from stored_runs import MATERIAL, calibration, journalled, reconstruction, short_run

from cbsr_qa.calibration.file.hdf5 import stamp, verify_calibration_file, write_calibration
from cbsr_qa.domain.errors import CalibrationError, StoreError
from cbsr_qa.domain.imaging import ParameterChoice
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.calibration import BaselineConductance, Validity
from cbsr_qa.domain.results.measurement import Verdict
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.store.opening import open_store


@pytest.fixture
def repository(tmp_path):
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}") as opened:
        yield opened


def of_before(repository, *, forces=False, observation=None, **changes):
    """A calibration of a run, stored as it was up to schema 0011."""
    run = repository.new_id()
    journalled(repository, short_run(run))
    made = calibration(repository.new_id(), run, **changes)
    if forces:
        model = sample_force(int(made.reconstruction.problem.used.sum()))
        made = stamp(replace(made, force=model, digest="", record_digest=""))
    result = RunResult(repository.load_run(run), observation, (), Verdict(Outcome.PASS, "why"), None, "")
    store_as_rows(repository, made, repository.save_result(result))
    assert repository.calibration_file(made.calibration) is None
    return made


def prepares(made):
    """What prepares templates, told what it was asked for."""
    asked = []

    def prepare(*about):
        asked.append(about)
        empty = np.zeros(len(made.force.log_response))
        return replace(made.force, log_response=empty, log_response_stderr=empty, scatter=0.0, loading=None)

    return prepare, asked


def unused(*_):
    raise AssertionError


def unchained(tmp_path):
    """Make every run one of before chains."""
    with sqlite3.connect(tmp_path / "runs.db") as other:
        other.execute("delete from run_links")
        other.execute("update runs set chain = null")


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"relaxations": (), "size_ratio": None, "noise_figure": None, "settling": (), "overlap_bands": ()},
        {"against_stress": MATERIAL.against_stress, "validity": Validity(None, (0.2, 0.2), (20.5, 21.0), 0.0)},
        {"baseline": (BaselineConductance("L0", -0.0, 1 / 3, 0.1 + 0.2, 5e-324, 1),), "scale": -7.1},
    ],
)
def test_its_rows_give_the_file_that_was_issued(repository, tmp_path, changes):
    issued = of_before(repository, **changes)
    write_calibration(tmp_path / "issued.h5", issued)
    back = repository.calibration_of_before(issued.calibration, reconstruction(), unused)
    write_calibration(tmp_path / "exported.h5", back)
    assert (tmp_path / "exported.h5").read_bytes() == (tmp_path / "issued.h5").read_bytes()


def test_a_force_model_comes_back_as_it_was_issued(repository):
    made = of_before(repository, forces=True)
    prepare, asked = prepares(made)
    back = repository.calibration_of_before(made.calibration, made.reconstruction, prepare)
    assert_same(back, made, "calibration")
    ((sensor_type, used, merging, reference, head),) = asked
    assert (sensor_type, head) == (made.sensor_type, made.indenter)
    for one, other in (
        (used, made.reconstruction.problem.used),
        (merging, made.force.merging),
        (reference, made.reference),
    ):
        np.testing.assert_array_equal(one, other)


def test_a_map_of_another_lattice_is_not_loaded(repository):
    made = of_before(repository, forces=True)
    prepare, _ = prepares(replace(made, force=replace(made.force, templates=made.force.templates[:50])))
    with pytest.raises(StoreError, match="a map of 52 places; this version prepares templates for 50"):
        repository.calibration_of_before(made.calibration, made.reconstruction, prepare)


def test_a_matrix_prepared_again_elsewhere_keeps_the_record_and_is_exported(repository, tmp_path):
    issued, here = of_before(repository), reconstruction()
    there = replace(
        here, matrix=np.nextafter(here.matrix, 2.0), choice=replace(here.choice, value=0.02 * (1 + 1e-9), how="again")
    )
    back = repository.calibration_of_before(issued.calibration, there, unused)
    assert back.reconstruction.choice == issued.reconstruction.choice
    assert write_calibration(tmp_path / "exported.h5", back) != issued.digest
    assert verify_calibration_file(tmp_path / "exported.h5").record_digest == issued.record_digest


@pytest.mark.parametrize(
    "edit",
    [
        "update calibration_baselines set value = 2.0 where number = 0",
        "update calibration_relaxations set amplitude_2 = -0.06 where number = 0",
        "delete from calibration_relaxations where number = 2",
        "update calibrations set stress_covariance = 0",
        "update calibration_parameters set value = 1 where name like '%strain.slope'",
        "update calibration_forces set scatter = 0.5",
    ],
)
def test_edited_rows_are_not_exported(repository, tmp_path, edit):
    issued = of_before(repository, forces=True)
    prepare, _ = prepares(issued)
    with sqlite3.connect(tmp_path / "runs.db") as other:
        assert other.execute(edit).rowcount == 1
    with pytest.raises(StoreError, match=r"calibration\w+ \(calibration .+\) was changed"):
        repository.calibration_of_before(issued.calibration, None, prepare)
    unchained(tmp_path)
    back = repository.calibration_of_before(issued.calibration, issued.reconstruction, prepare)
    with pytest.raises(CalibrationError, match="not what was issued"):
        write_calibration(tmp_path / "exported.h5", back)


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (
            "update calibration_forces set log_response = log_response_stderr",
            "its force model is not what was stored",
        ),
        ("update calibrations set reference = zeroblob(length(reference))", "its reference frame is not what was"),
        ("update calibrations set used = zeroblob(length(used))", "its reference frame is not what was stored"),
    ],
)
def test_edited_arrays_are_refused_with_and_without_a_matrix(repository, tmp_path, edit, said):
    issued = of_before(repository, forces=True)
    with sqlite3.connect(tmp_path / "runs.db") as other:
        assert other.execute(edit).rowcount == 1
    for matrix in (None, issued.reconstruction):
        with pytest.raises(StoreError, match=said):
            repository.calibration_of_before(issued.calibration, matrix, unused)


def of_other_readings(whole):
    problem, fewer = whole.problem, whole.problem.used.copy()
    fewer[0, 2] = False
    less = replace(problem, used=fewer, jacobian=problem.jacobian[1:], reference=problem.reference[1:])
    return replace(whole, problem=less, matrix=whole.matrix[:, 1:])


def weighed(variance):
    return lambda whole: replace(whole, problem=replace(whole.problem, noise_variance=variance))


OTHERS = {
    "of another making": (
        "equal",
        lambda whole: replace(whole, choice=ParameterChoice(0.5, "by hand", 2.0)),
        r"share kept = 0\.02, not with .* λ = 0\.5",
    ),
    "for other readings": ("equal", of_other_readings, "208 readings of a disc-100mm"),
    "with measured weights": ("equal", weighed(np.ones(208)), "made with equal noise weighting"),
    "with equal weights": ("measured", weighed(None), "made with measured noise weighting"),
}


@pytest.mark.parametrize(("weighting", "other", "said"), OTHERS.values(), ids=OTHERS)
def test_another_matrix_is_refused(repository, weighting, other, said):
    seen = SimpleNamespace(settings=SimpleNamespace(noise_weighting=weighting), weight_ratio=1.0)
    issued = of_before(repository, observation=seen)
    with pytest.raises(StoreError, match=said):
        repository.calibration_of_before(issued.calibration, other(reconstruction()), unused)
