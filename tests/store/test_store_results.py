"""Analyses and calibrations: added, never changed, and what a query finds is what was concluded."""

import sqlite3
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from calibration_samples import assert_same
from stored_runs import calibration, journalled, short_run

from cbsr_qa.calibration.file.hdf5 import calibration_of, write_calibration
from cbsr_qa.domain.errors import CalibrationError, StoreError
from cbsr_qa.domain.plan.limits import Bound, Limit, Outcome
from cbsr_qa.domain.results.calibration import BaselineConductance
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.store.opening import open_store

MEASURED = (
    Measurement("centre_of_mass_error", 1.2, "mm", 0.1, "nine locations", "L3", 0, "mask 85 %", "exact").judge(
        Limit("centre_of_mass_error", "mm", None, 6.5, 1.5, "nine locations", "mask 85 %")
    ),
    Measurement("area_overlap", None, "%", how="no blob").judge(Limit("area_overlap", "%", 50.0, None)),
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
        "record": repository.runs.load(run),
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
    name = repository.analyses.save(result(repository, run), software=[("cbsr-qa", "9")])
    (back,) = repository.analyses.load(run)
    assert (back.analysis, back.run, back.software) == (name, run, (("cbsr-qa", "9"),))
    assert back.verdict == Verdict(Outcome.PASS, "all limits are met")
    assert back.measurements == MEASURED
    assert (back.warnings, back.compute_s) == (("first", "second"), (("imaging", 0.25),))
    assert (back.calibration, back.calibration_why) == (None, "not asked for")
    assert back.analysed_at.tzinfo is not None


def test_judging_again_adds_an_analysis_and_the_latest_holds(repository, run):
    first = repository.analyses.save(result(repository, run))
    before = repository.analyses.load(run)
    second = repository.analyses.save(result(repository, run, Outcome.FAIL, measurements=MEASURED[:1]))
    assert [a.analysis for a in repository.analyses.load(run)] == [second, first]
    assert repository.analyses.load(run)[1:] == before
    (summary,) = repository.runs.find("S-1")
    assert summary.outcome is Outcome.FAIL


def test_loads_of_one_label_and_trial_at_six_strains_stay_apart(repository, run):
    measured = tuple(
        Measurement("settling_time", 20.0 + k, "s", phase="campaign", location="L0", trial=0, bound=bound).judge(
            Limit("settling_time", "s", None, 23.0)
        )
        for k, bound in enumerate([Bound.EXACT, Bound.LOWER] * 3)
    )
    measured = tuple(replace(m, load=9 * k, strain=0.05 * (k + 1)) for k, m in enumerate(measured))
    repository.analyses.save(result(repository, run, measurements=measured))
    (back,) = repository.analyses.load(run)
    assert back.measurements == measured
    assert {(m.phase, m.load): m.strain for m in back.measurements} == {
        ("campaign", 9 * k): 0.05 * (k + 1) for k in range(6)
    }


def test_numpy_numbers_are_stored_as_plain_ones(repository, run):
    measured = Measurement("noise_floor", np.float64(0.5), "1", trial=np.int64(2))
    repository.analyses.save(result(repository, run, measurements=(measured,)))
    (back,) = repository.analyses.load(run)[0].measurements
    assert (back.value, back.trial) == (0.5, 2)
    assert type(back.trial) is int


def test_a_calibration_comes_back_as_it_was_issued_to_the_byte(repository, run, tmp_path):
    issued = calibration(repository.new_id(), run)
    repository.analyses.save(result(repository, run, calibration=issued, calibration_why=""))
    assert repository.analyses.load(run)[0].calibration == issued.calibration
    file, digest = repository.calibrations.load_file(issued.calibration)
    write_calibration(tmp_path / "issued.h5", issued)
    assert (file, digest) == ((tmp_path / "issued.h5").read_bytes(), issued.digest)
    assert_same(calibration_of(file, issued=digest), issued, "calibration")
    with sqlite3.connect(tmp_path / "runs.db") as other:
        searched = other.execute("select content_sha256, record_sha256, run, serial from calibrations").fetchone()
        places = other.execute("select location, value from calibration_baselines order by number").fetchall()
    assert searched == (issued.digest, issued.record_digest, run, "S-1")
    assert places == [(place.location, place.value) for place in issued.baseline]


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        ("update calibrations set file = substr(file, 1, length(file) - 1)", "its file is not what was stored"),
        ("update calibrations set file = x''", "its file is not what was stored"),
        ("update calibrations set file_sha256 = ''", "was changed"),
        ("update calibrations set file = x'', file_sha256 = ''", "was changed"),
    ],
)
def test_a_calibration_that_was_edited_is_not_handed_out(repository, run, tmp_path, edit, said):
    issued = calibration(repository.new_id(), run)
    repository.analyses.save(result(repository, run, calibration=issued))
    with sqlite3.connect(tmp_path / "runs.db") as other:
        assert other.execute(edit).rowcount == 1
    with pytest.raises(StoreError, match=said):
        repository.calibrations.load_file(issued.calibration)


def test_the_file_of_another_calibration_is_refused(repository, run):
    first, other = (calibration(repository.new_id(), run, scale=scale) for scale in (7.0, 8.0))
    assert first.digest != other.digest
    with pytest.raises(CalibrationError, match=f"holds another calibration.* {first.digest} was issued"):
        calibration_of(other.file, issued=first.digest)


def test_there_is_no_file_of_a_calibration_that_is_not_there(repository):
    with pytest.raises(StoreError, match="there is no calibration 'nothing'"):
        repository.calibrations.load_file("nothing")


def test_a_calibration_that_was_never_issued_is_not_stored(repository, run):
    made = replace(calibration(repository.new_id(), run), digest="", record_digest="")
    with pytest.raises(StoreError, match="never issued"):
        repository.analyses.save(result(repository, run, calibration=made))
    assert repository.analyses.load(run) == ()


@pytest.mark.rest
def test_a_new_calibration_supersedes_only_the_same_sensors_earlier_ones(repository, run):
    other_run = repository.new_id()
    journalled(repository, short_run(other_run, "S-2"))
    names = [repository.new_id() for _ in range(4)]
    for name in names[:3]:
        repository.analyses.save(result(repository, run, calibration=calibration(name, run)))
    other = calibration(names[3], other_run, "S-2")
    repository.analyses.save(result(repository, other_run, calibration=other))
    held = {c.calibration: c.superseded_by for c in repository.calibrations.list_issued("S-1")}
    assert held == {names[0]: names[1], names[1]: names[2], names[2]: None}
    assert [c.superseded_by for c in repository.calibrations.list_issued("S-2")] == [None]


def test_a_number_that_is_not_finite_stores_nothing_at_all(repository, run):
    place = BaselineConductance("L0", 0.0, 0.0, float("nan"), None, 1)
    bad = calibration(repository.new_id(), run, baseline=(place,))
    with pytest.raises(StoreError, match="not a finite number"):
        repository.analyses.save(result(repository, run, calibration=bad))
    assert repository.analyses.load(run) == ()
    assert repository.calibrations.list_issued("S-1") == ()


def test_a_result_of_a_run_that_is_not_stored_is_refused(repository, run):
    stranger = replace(repository.runs.load(run).identity, run="unknown")
    record = replace(repository.runs.load(run), identity=stranger)
    with pytest.raises(StoreError):
        repository.analyses.save(result(repository, run, record=record))


def test_runs_are_found_by_serial_and_by_name(repository, run):
    later = repository.new_id()
    journalled(repository, short_run(later))
    assert [r.run for r in repository.runs.find("S-1")] == [later, run]
    assert repository.runs.find("nobody") == ()
    assert repository.runs.resolve("S-1") == later
    assert repository.runs.resolve(run) == run
    with pytest.raises(StoreError, match="no run and no sensor"):
        repository.runs.resolve("../../x")
    with pytest.raises(StoreError, match="no run"):
        repository.runs.load("nothing")
    assert repository.count_rows() == {"sensors": 1, "runs": 2, "frames": 22, "samples": 80, "loads": 2}


def test_the_analysis_says_how_readings_were_weighed(repository, run):
    plain = repository.analyses.save(result(repository, run))
    seen = SimpleNamespace(settings=SimpleNamespace(noise_weighting="measured"), weight_ratio=3.5)
    weighed = repository.analyses.save(result(repository, run, observation=seen))
    stored = {a.analysis: (a.noise_weighting, a.weight_ratio) for a in repository.analyses.load(run)}
    assert stored == {plain: ("", None), weighed: ("measured", 3.5)}
