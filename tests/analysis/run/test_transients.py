"""Short holds brought to where the run's longest ones end, and what a calibration from them says of itself."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_runs import simulated_run

from cbsr_qa.analysis.run.compensation import LARGEST_FACTOR, _limit_rise
from cbsr_qa.analysis.run.force import force_tests, hold_traces, learn_without_tests, run_force
from cbsr_qa.analysis.run.observe import observe_run
from cbsr_qa.calibration.force.validity import force_reductions
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa_plugins.sections.force import _list_caveats, _prediction_blocks

LONG = 3
SHORT_S = 15.0


def cut(load):
    """A load whose last frames and force are those of a hold that ended earlier."""
    end_s = load.hold_start_s + SHORT_S
    ramp_s = load.clear_s - load.release_start_s
    return replace(load, release_start_s=end_s, clear_s=end_s + ramp_s, release_end_s=end_s + ramp_s)


@pytest.fixture(scope="module")
def runs():
    """Nine loads held for a minute as they are, and with the first six cut to 15 s, averaged and predicted."""
    whole = simulated_run(NINE_LOCATIONS_MM, strain=0.25, noise=2e-4, seed=8)
    (phase,) = whole.phases
    loads = (*map(cut, phase.loads[:-LONG]), *phase.loads[-LONG:])
    short = replace(whole, phases=(replace(phase, loads=loads),))
    reconstruction = discover().factory(Kind.RECONSTRUCTION, "gauss-newton-noser")(hyperparameter=0.1)
    settings = replace(load_recipe("nine-locations").value.analysis, calibrate_phases=("grid",))

    def observed(record, transients):
        return observe_run(record, reconstruction, replace(settings, transients=transients), over_time=False)

    return observed(whole, "averaged"), observed(short, "averaged"), observed(short, "predicted")


def ratios(run):
    return learn_without_tests(run).learned.ratio[:-LONG]


@pytest.mark.rest
def test_predicted_holds_say_what_whole_ones_do(runs):
    whole, averaged, predicted = map(ratios, runs)
    assert abs(np.mean(predicted / whole) - 1) < 0.02
    assert np.std(predicted / whole) < 0.05
    # A quarter of the change is still to come after 15 s, and the stress has a third of its relaxation before it.
    assert np.mean(averaged / whole) < 0.75


def test_errors_of_predicted_loads_hold_what_they_are_off_by(runs):
    whole, _, predicted = runs
    found = learn_without_tests(predicted).learned
    off = (found.ratio / learn_without_tests(whole).learned.ratio - 1)[:-LONG]
    stated = (found.ratio_stderr / found.ratio)[:-LONG]
    assert np.sqrt(np.mean((off / stated) ** 2)) < 1.6
    assert (
        stated > (learn_without_tests(whole).learned.ratio_stderr / learn_without_tests(whole).learned.ratio)[:-LONG]
    ).all()


@pytest.mark.rest
def test_forces_of_another_hold_follow(runs):
    whole, averaged, predicted = runs
    rms = {
        name: np.sqrt(
            np.mean([(t.known_N - t.measured_N) ** 2 for t in force_tests(whole, learn_without_tests(run).learned)])
        )
        for name, run in (("whole", whole), ("averaged", averaged), ("predicted", predicted))
    }
    assert rms["predicted"] < rms["whole"] + 0.1
    assert rms["averaged"] > 4 * rms["predicted"]


def test_the_model_says_of_what_time_its_forces_are(runs):
    whole, _, predicted = runs
    ends = [load.record.release_start_s - load.record.hold_start_s for load in whole.loads]
    assert learn_without_tests(predicted).learned.model.steady_s == pytest.approx(np.mean(ends) - 5.0, abs=2.0)


def test_a_run_whose_holds_are_alike_is_left_as_it_is(runs):
    whole = runs[0]
    same = replace(whole, settings=replace(whole.settings, transients="predicted"))
    np.testing.assert_array_equal(learn_without_tests(same).learned.ratio, learn_without_tests(whole).learned.ratio)


def test_holds_too_short_to_show_how_they_relax_are_refused_by_name(runs):
    _, _, predicted = runs
    few = replace(predicted, loads=predicted.loads[:-LONG])
    shorter = tuple(
        replace(load, record=replace(load.record, release_start_s=load.record.hold_start_s + 3.0))
        for load in few.loads[1:]
    )
    bare = replace(few, loads=(replace(few.loads[0], record=_held_for(few.loads[0], 6.0)), *shorter))
    with pytest.raises(NumericsError, match="longest holds do not determine how the conductance relaxes"):
        learn_without_tests(bare)
    assert "longest holds" in run_force(bare).why


def _held_for(load, seconds):
    return replace(load.record, release_start_s=load.record.hold_start_s + seconds)


def test_loads_have_the_force_of_the_time_they_are_predicted_to(runs):
    whole, _, short = runs
    found = learn_without_tests(short)
    forces = np.array([load.force_N for load in found.used])
    truth = np.array([load.force_N for load in whole.loads])
    early = np.array([load.force_N for load in short.loads])
    # After 10 s the stress still stands 4 to 5 % above what it is after a minute.
    assert (early / truth - 1)[:-LONG].min() > 0.04
    assert np.abs(forces / truth - 1).max() < 0.004
    line, area = short.record.material.against_stress, short.record.indenter.area_mm2
    contrast = found.learned.ratio * (line.slope.value * forces / area * 1e3 + line.intercept.value)
    expected = learn_without_tests(whole).learned.ratio * (
        line.slope.value * truth / area * 1e3 + line.intercept.value
    )
    assert np.abs(np.mean(contrast / expected) - 1) < 0.02


def test_predicted_loads_are_counted_and_named(runs):
    whole, _, short = runs
    found = run_force(short)
    assert found.learned.predicted == (True,) * 6 + (False,) * LONG
    (words,) = [one for one in force_reductions(found.learned, found.used) if "predicted" in one]
    assert words.startswith("6 of 9 loads were held for a shorter time than the run's longest")
    assert f"to {found.learned.model.steady_s:.0f} s after the press" in words
    (shown,) = _prediction_blocks(short, found.learned)
    assert words in shown.text
    assert not any("predicted" in one for one in force_reductions(learn_without_tests(whole).learned, whole.loads))
    assert _prediction_blocks(whole, learn_without_tests(whole).learned) == []


def test_predicted_loads_are_not_said_to_be_unsettled(runs):
    _, _, short = runs
    unsettled = replace(short, loads=tuple(replace(load, settled=False) for load in short.loads))
    found = run_force(unsettled)
    (words,) = [one for one in _list_caveats(unsettled, found, found.learned, ()) if "settling times" in one]
    assert words.startswith(f"{LONG} loads of the calibration")


def test_traces_of_predicted_loads_are_found_whoever_asks(runs):
    whole, _, short = runs
    learned = learn_without_tests(short)
    force_tests(whole, learned.learned)
    learn_without_tests(whole)  # what is kept of the short run may be gone by now
    for loads in (short.loads, learned.used):
        times, strengths = hold_traces(short, loads)[0]
        assert len(times) == len(strengths) > 3


@pytest.mark.parametrize(
    ("predicted", "seen", "factor"),
    [
        (1.5, 1.0, 1.5),
        (-3.0, -2.0, 1.5),
        (1.0, 0.01, LARGEST_FACTOR),
        (1.0, -0.01, 1 / LARGEST_FACTOR),
        (1.0, 0.0, 1),
    ],
)
def test_noise_over_noise_raises_no_reading_out_of_bounds(predicted, seen, factor):
    assert _limit_rise(predicted, seen) == pytest.approx(factor)
