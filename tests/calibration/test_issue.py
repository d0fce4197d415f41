"""Issuing: only for a passed, finished run, with what was assumed and what reduces its range."""

from dataclasses import replace

import numpy as np
import pytest
from observation_samples import sample_load, sample_relaxation, sample_run

from cbsr_qa.calibration.issue import issue_calibration
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.readings.frames import SampleBlock
from cbsr_qa.domain.results.measurement import Verdict
from cbsr_qa.domain.run.states import EndReason

PASSED = Verdict(Outcome.PASS, "all limits are met")


def _loads():
    return (
        replace(
            sample_load("L0", force_N=3.0),
            relaxations=(sample_relaxation(20.0), sample_relaxation(40.0, loading=False)),
        ),
        replace(
            sample_load("L1", (30.0, 0.0), blob_mm=(30.0, 0.0, 6.5), force_N=2.0),
            relaxations=(sample_relaxation(60.0, censored=True), sample_relaxation(None, loading=False)),
        ),
        sample_load("R0", (40.0, 0.0), blob_mm=(40.0, 0.0, 6.5), force_N=9.0, phase="random loads"),
    )


def _issue(run, verdict=PASSED, **changes):
    arguments = {
        "calibration": "0193-cal",
        "issued_at": "2026-01-01T10:00:00+00:00",
        "phases": ("nine locations",),
        "overlap_threshold": 50.0,
    }
    return issue_calibration(run, verdict, **(arguments | changes))


_RUN = sample_run(_loads())


def test_a_passed_run_issues_what_it_measured():
    run = sample_run(_loads())
    issued = _issue(run)
    assert (issued.calibration, issued.run, issued.issued_at) == ("0193-cal", "0193-run", "2026-01-01T10:00:00+00:00")
    assert issued.sensor == run.record.identity.sensor
    assert [place.location for place in issued.baseline] == ["L0", "L1"]
    assert issued.against_stress == run.record.material.against_stress
    assert issued.assumed == ("α against stress", "β against stress", "α against strain", "β against strain")
    assert issued.simulated == ("everything",)
    assert issued.overlap_bands == run.settings.overlap_bands
    assert (issued.current_A, issued.scale, issued.noise_floor, issued.mask) == (1e-3, 10.0, 0.005, 0.85)
    assert np.array_equal(issued.reference, run.reference)
    assert issued.size_ratio == run.settings.size_ratio
    assert (issued.noise_figure, _issue(run, noise_figure=1.2).noise_figure) == (None, 1.2)


def test_a_relaxation_says_of_which_load_it_is_and_in_what_unit():
    first, *_ = _loads()
    strained = replace(first, record=replace(first.record, index=9, load=replace(first.record.load, strain=0.3)))
    issued = _issue(sample_run((first, strained)))
    assert [(r.phase, r.load, r.strain) for r in issued.relaxations] == [
        ("nine locations", index, strain) for index, strain in ((0, 0.2), (0, 0.2), (9, 0.3), (9, 0.3))
    ]
    assert {r.unit for r in issued.relaxations} == {"1"}


def test_the_time_of_issue_is_in_utc():
    assert _issue(_RUN, issued_at="2026-01-01T23:00:00+13:00").issued_at == "2026-01-01T10:00:00+00:00"


def test_the_range_is_that_of_the_loads_of_the_named_phases():
    validity = _issue(sample_run(_loads())).validity
    assert validity.force_N == (2.0, 3.0)
    assert validity.strain == (0.2, 0.2)
    assert validity.radius_mm == 30.0
    assert validity.temperature_C is None
    assert validity.reduced == ("no force model: no force model was requested",)
    few = _issue(_RUN, no_force="1 of 7 loads say something; 3 are needed")
    assert few.no_force == "1 of 7 loads say something; 3 are needed"
    assert few.validity.reduced == (f"no force model: {few.no_force}",)
    wider = _issue(sample_run(_loads()), phases=("nine locations", "random loads")).validity
    assert (wider.force_N, wider.radius_mm) == ((2.0, 9.0), 40.0)


def test_the_temperature_range_is_the_recorded_one():
    run = sample_run(_loads())
    warm = SampleBlock("temperature", "°C", np.arange(3.0), np.array([21.0, 23.5, 22.0]))
    phases = (replace(run.record.phases[0], samples=(warm,)), *run.record.phases[1:])
    run = replace(run, record=replace(run.record, phases=phases))
    assert _issue(run).validity.temperature_C == (21.0, 23.5)


def test_settling_is_summarised_with_censored_ones_as_lower_bounds():
    loading, unloading = _issue(sample_run(_loads())).settling
    assert (loading.signal, loading.loading, loading.mean_s) == ("conductance", True, 40.0)
    assert (loading.accepted, loading.censored, loading.rejected) == (1, 1, 0)
    assert (unloading.mean_s, unloading.accepted, unloading.censored, unloading.rejected) == (40.0, 1, 0, 1)


def test_a_place_that_says_nothing_reduces_the_range():
    loads = (sample_load("L0"), sample_load("L1", (30.0, 0.0), blob_mm=None))
    run = sample_run(loads)
    lost = run.usable.copy()
    lost[0, 2] = False
    issued = _issue(replace(run, usable=lost))
    assert issued.validity.radius_mm == 0.0
    assert issued.baseline[1].value is None
    assert issued.validity.reduced[0] == "L1 at (30, 0) mm is left out: no blob was sensed"
    assert issued.validity.reduced[-1].startswith("1 readings were not imaged")


def test_a_marginal_run_gets_one():
    assert _issue(sample_run(_loads()), Verdict(Outcome.MARGINAL, "close")).run == "0193-run"


@pytest.mark.parametrize(
    ("run", "verdict", "changes", "said"),
    [
        *(
            (_RUN, Verdict(outcome, "because"), {}, f"verdict is {outcome}.*because")
            for outcome in (Outcome.FAIL, Outcome.NOT_MEASURED, Outcome.NOT_JUDGED)
        ),
        (replace(_RUN, record=replace(_RUN.record, end=EndReason.ABORTED)), PASSED, {}, "not finished"),
        (sample_run((sample_load(force_N=None),)), PASSED, {}, "no force was recorded"),
        (_RUN, PASSED, {"phases": ("elsewhere",)}, "no load in elsewhere"),
        (sample_run(_loads(), current_A=None), PASSED, {}, "drive current"),
        (_RUN, PASSED, {"issued_at": "2026-01-01T10:00:00"}, "states no zone"),
        (_RUN, PASSED, {"issued_at": "yesterday"}, "not an ISO time"),
    ],
)
def test_what_gets_no_calibration_says_why(run, verdict, changes, said):
    with pytest.raises(CalibrationError, match=said):
        _issue(run, verdict, **changes)
