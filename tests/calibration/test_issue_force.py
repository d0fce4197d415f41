"""Issuing with a force model: its range, what is assumed, and every reason for less than was intended."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_samples import sample_force
from observation_samples import sample_load, sample_run
from test_issue import _issue

from cbsr_qa.analysis.defects.load_cell import describe_cell_limit
from cbsr_qa.calibration.force.learning import LearnedForce
from cbsr_qa.calibration.force.validity import reading_reductions
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.readings.frames import SampleBlock
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic

_PLACES = [(0.0, 0.0), (30.0, 0.0), (-30.0, 0.0), (0.0, 30.0), (0.0, -30.0), (15.0, 15.0), (36.0, 0.0)]
_LINE = QuasiStatic(Parameter(4.5e-3, 1e-5, "a test"), Parameter(-2e-3, 1e-4, "fitted"), -5e-10)


def _loads(strains=(0.1, 0.2)):
    loads = []
    for number, (x, y) in enumerate(_PLACES):
        strain = strains[number % len(strains)]
        load = sample_load(f"L{number}", (x, y), blob_mm=(x, y, 6.5), force_N=1.0 + number, index=number)
        loads.append(replace(load, record=replace(load.record, load=replace(load.record.load, strain=strain))))
    return tuple(loads)


def _learned(run, refused=("",) * 7, *, fitted=True):
    used = np.array([not why for why in refused])
    model = sample_force(int(run.usable.sum()))
    ratio = np.where(used, 1.0, np.nan)
    return LearnedForce(model, _LINE, None, refused, ratio, ratio / 50, fitted)


def _issued(loads, refused=("",) * 7, *, fitted=True):
    run = sample_run(loads)
    return _issue(run, learned=_learned(run, refused, fitted=fitted), learned_from=loads), run


def test_the_learned_line_takes_the_place_of_the_materials_and_baselines_are_taken_with_it():
    issued, run = _issued(_loads())
    assert issued.against_stress == _LINE
    assert issued.assumed == ("α against stress", "α against strain", "β against strain")
    assert issued.no_force == ""
    plain = _issue(run)
    assert (plain.force, plain.no_force) == (None, "no force model was requested")
    stress = run.loads[3].stress_kPa
    factor = 4.5e-3 * stress / (4.5e-3 * stress - 2e-3)
    assert issued.baseline[3].value == pytest.approx(plain.baseline[3].value * factor, rel=1e-12)


def test_the_range_is_that_of_the_loads_that_were_used_and_the_others_are_named():
    why = "the standard error of its amplitude is 40%"
    validity = _issued(_loads(), ("", "", "", "", "", "", why))[0].validity
    assert (validity.force_N, validity.radius_mm, validity.strain) == ((1.0, 6.0), 30.0, (0.1, 0.2))
    assert validity.reduced == (
        f"no force was learned from L6 at (36, 0) mm, trial 0: {why}",
        "the scatter of loads is known from only 6: stated uncertainties may hold fewer than 95 % of errors",
    )
    assert _issued(_loads())[0].validity.radius_mm == 36.0
    assert _issued((*_loads(), *_loads()), ("",) * 14)[0].validity.reduced == ()


def test_many_loads_refused_for_one_reason_are_one_reason():
    loads = (*_loads(), *_loads())
    refused = ("",) * 7 + ("it changed in the direction opposite to the material's response",) * 7
    reason, _ = _issued(loads, refused)[0].validity.reduced
    assert reason.startswith("no force was learned from L0 at (0, 0) mm, trial 0, L1 at")
    assert "and 1 more: it changed in the direction opposite" in reason


@pytest.mark.parametrize(
    ("strains", "fitted", "said"),
    [
        ((0.2,), False, "all loads were pressed at one strain (20 %): the intercept"),
        ((0.1, 0.2), False, "all loads had the same stress (8.25 to 41.5 kPa): the intercept"),
        ((0.2,), True, "all loads were pressed at one strain (20 %)"),
    ],
)
def test_loads_that_press_alike_say_nothing_of_the_intercept(strains, fitted, said):
    issued, _ = _issued(_loads(strains), fitted=fitted)
    reason, scatter = sorted(issued.validity.reduced)
    assert reason.startswith(said)
    assert scatter.startswith("the scatter of loads is known from only 7")
    assert ("β against stress" in issued.assumed) is not fitted


def test_few_places_are_a_reason():
    why = "the load does not stand out of the noise of the readings"
    reasons = _issued(_loads(), ("", "", "", why, why, why, why))[0].validity.reduced
    assert any(reason.startswith("force was learned at only 3 places") for reason in reasons)


def test_an_electrode_of_which_no_reading_could_be_used_is_named():
    pattern = adjacent_pattern(16)
    usable = pattern.usable()
    assert list(reading_reductions(pattern, usable)) == []
    drive, measure = np.array(pattern.drive), np.array(pattern.measure)
    for electrode in (5, 11):
        usable[(drive == electrode).any(axis=1)] = False
        usable[:, (measure == electrode).any(axis=1)] = False
    lost = int((pattern.usable() & ~usable).sum())
    counted, dead = reading_reductions(pattern, usable)
    assert counted.startswith(f"{lost} readings were not imaged")
    assert dead.startswith("electrodes 5, 11 are dead")
    one = pattern.usable()
    one[0, 5] = False
    assert list(reading_reductions(pattern, one)) == [
        "1 readings were not imaged: saturated, constant or not connected"
    ]


# --- the load cell -------------------------------------------------------------------------------------------


def _force(held, *, noise=0.01, seed=0):
    """Samples every 0.5 s through a press that is held from 101 to 161 s and rests from 162 to 222 s."""
    time_s = np.arange(90.0, 222.0, 0.5)
    random = np.random.default_rng(seed)
    values = noise * random.standard_normal(len(time_s))
    during = (time_s >= 101) & (time_s < 161)
    values[during] = held(time_s[during] - 101, random)
    return SampleBlock("force", "N", time_s, values)


_RECORD = sample_load().record


def test_a_cell_that_stands_at_its_highest_reading_all_through_a_hold_is_saturated():
    said = describe_cell_limit(_force(lambda t, _: np.full(len(t), 5.0)), _RECORD)
    assert said == "the load cell read 5 N, its highest reading, throughout the hold: it is saturated"
    clipped = _force(lambda t, random: np.minimum(6.0 + 0.3 * random.standard_normal(len(t)), 5.0))
    assert "saturated" in describe_cell_limit(clipped, _RECORD)


@pytest.mark.parametrize(
    "held",
    [
        lambda t, _: 3 + 2 * np.exp(-t / 20),
        lambda t, random: 5 + 0.01 * random.standard_normal(len(t)),
        lambda t, _: np.where(t < 1, 5.0, 4.9),
        lambda t, random: np.round(5 + 0.03 * random.standard_normal(len(t)), 2),
    ],
)
def test_a_cell_that_relaxes_or_is_noisy_is_not(held):
    assert describe_cell_limit(_force(held), _RECORD) == ""


def test_where_nothing_has_noise_nothing_can_be_told():
    assert describe_cell_limit(_force(lambda t, _: np.full(len(t), 5.0), noise=0.0), _RECORD) == ""
    assert describe_cell_limit(None, _RECORD) == ""
    few = _force(lambda t, _: np.full(len(t), 5.0))
    assert describe_cell_limit(SampleBlock("force", "N", few.time_s[::40], few.values[::40]), _RECORD) == ""


def test_a_load_whose_cell_was_saturated_says_so_where_its_force_is_missed():
    saturated = replace(sample_load("L0", force_N=None, trial=1), no_force="the load cell stood at 5 N")
    issued = _issue(sample_run((*_loads(), saturated)))
    assert issued.validity.reduced[0] == (
        "no force was measured of L0 at (0, 0) mm, trial 1: the load cell stood at 5 N"
    )
    assert issued.baseline[0].value is not None
    alone = replace(sample_load("L9", (3.0, 3.0), force_N=None), no_force="the load cell stood at 5 N")
    reduced = _issue(sample_run((*_loads(), alone))).validity.reduced
    assert reduced[0] == "L9 at (3, 3) mm is left out: the load cell stood at 5 N"


def test_a_run_whose_load_cell_was_saturated_throughout_is_refused_for_that_reason():
    loads = tuple(replace(load, force_N=None, no_force="the load cell stood at 5 N") for load in _loads())
    with pytest.raises(CalibrationError, match="no load gives a baseline conductance: the load cell stood at 5 N"):
        _issue(sample_run(loads))
