"""Short holds brought to where the run's longest ones end, on a simulated sensor that answers alike everywhere."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_runs import simulated_run

from cbsr_qa.analysis.run.force import force_tests, learned_from, run_force
from cbsr_qa.analysis.run.observe import observe_run
from cbsr_qa.config import load_recipe
from cbsr_qa.domain import NumericsError
from cbsr_qa.domain.run import NINE_LOCATIONS_MM
from cbsr_qa.plugin import Kind, discover
from cbsr_qa.studies.frontier import shortened

LONG = 3  # loads that are held for a minute; the others are cut
SHORT_S = 15.0


@pytest.fixture(scope="module")
def seen():
    """A run of nine loads held for a minute, observed as it is and with the first six cut to 15 s."""
    run = simulated_run(NINE_LOCATIONS_MM, strain=0.25, noise=2e-4, seed=5)
    reconstruction = discover().factory(Kind.RECONSTRUCTION, "gauss-newton-noser")(hyperparameter=0.1)
    settings = replace(load_recipe("nine-locations").value.analysis, calibrate_phases=("grid",))
    cut = shortened(replace(run, phases=(replace(run.phases[0], name="calibration places"),)), SHORT_S)
    (phase,) = cut.phases
    loads = (*phase.loads[:-LONG], *run.phases[0].loads[-LONG:])
    cut = replace(cut, phases=(replace(phase, name="grid", loads=loads),))

    def observed(record, transients):
        return observe_run(record, reconstruction, replace(settings, transients=transients), over_time=False)

    return observed(run, "averaged"), observed(cut, "averaged"), observed(cut, "predicted")


def ratios(run):
    return learned_from(run).learned.ratio[:-LONG]


@pytest.mark.rest
def test_predicted_holds_say_what_whole_ones_do(seen):
    whole, averaged, predicted = map(ratios, seen)
    assert abs(np.mean(predicted / whole) - 1) < 0.02
    assert np.std(predicted / whole) < 0.05
    # A quarter of the change is still to come after 15 s, and the stress has a third of its relaxation before it.
    assert np.mean(averaged / whole) < 0.75


def test_errors_of_predicted_loads_hold_what_they_are_off_by(seen):
    whole, _, predicted = seen
    found = learned_from(predicted).learned
    off = (found.ratio / learned_from(whole).learned.ratio - 1)[:-LONG]
    stated = (found.ratio_stderr / found.ratio)[:-LONG]
    assert np.sqrt(np.mean((off / stated) ** 2)) < 1.6
    assert (stated > (learned_from(whole).learned.ratio_stderr / learned_from(whole).learned.ratio)[:-LONG]).all()


def test_forces_of_another_hold_follow(seen):
    whole, averaged, predicted = seen
    rms = {
        name: np.sqrt(
            np.mean([(t.known_N - t.measured_N) ** 2 for t in force_tests(whole, learned_from(run).learned)])
        )
        for name, run in (("whole", whole), ("averaged", averaged), ("predicted", predicted))
    }
    assert rms["predicted"] < rms["whole"] + 0.1
    assert rms["averaged"] > 4 * rms["predicted"]


def test_the_model_says_of_what_time_its_forces_are(seen):
    whole, _, predicted = seen
    ends = [load.record.release_start_s - load.record.hold_start_s for load in whole.loads]
    assert learned_from(predicted).learned.model.steady_s == pytest.approx(np.mean(ends) - 5.0, abs=2.0)


def test_a_run_whose_holds_are_alike_is_left_as_it_is(seen):
    whole = seen[0]
    same = replace(whole, settings=replace(whole.settings, transients="predicted"))
    np.testing.assert_array_equal(learned_from(same).learned.ratio, learned_from(whole).learned.ratio)


def test_holds_too_short_to_show_how_they_relax_are_refused_by_name(seen):
    _, _, predicted = seen
    few = replace(predicted, loads=predicted.loads[:-LONG])
    shorter = tuple(
        replace(load, record=replace(load.record, release_start_s=load.record.hold_start_s + 3.0))
        for load in few.loads[1:]
    )
    bare = replace(few, loads=(replace(few.loads[0], record=_held_for(few.loads[0], 6.0)), *shorter))
    with pytest.raises(NumericsError, match="longest holds do not determine how the conductance relaxes"):
        learned_from(bare)
    assert "longest holds" in run_force(bare).why


def _held_for(load, seconds):
    return replace(load.record, release_start_s=load.record.hold_start_s + seconds)
