"""``frontier --stored``: runs analysed again with fewer places and shorter holds, the choice, and the recipe."""

import json
from dataclasses import replace

import numpy as np
import pytest
from demo_fleet import demo_fleet
from made_once import value_made_once

from cbsr_qa.analysis.run.force import force_tests, learn_without_tests
from cbsr_qa.analysis.run.observe import observe_run
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.studies.frontier.recommend import Target
from cbsr_qa.studies.frontier.setting import GRID, Setting
from cbsr_qa.studies.frontier.stored.study import CHANGE, FORCE, choose_way, write_stored_recipe
from cbsr_qa.studies.frontier.stored.trial import Design, StoredTrial, Way, measure_left_out_s, read_design, try_ways
from cbsr_qa.studies.frontier.trial import select_loads
from cbsr_qa.studies.simulated import configuration_of, copy_shipped, simulate_run

SIX = Setting(6, hold_s=25.0, rest_s=10.0, checks=3, first_rest_s=30.0)
DESIGN = Design(tuple((float(x), float(y)) for x in (-20, 0, 20) for y in (-20, 0, 20)), 60.0, False, 60.0)


def simulated():
    """Run, reconstruction and settings of six places and three random loads."""
    recipe = SIX.recipe() | {"limits": []}
    station = copy_shipped(DocumentKind.STATION, "simulated")
    configuration = configuration_of(station, recipe, "cbsr-8wt", seed=11)
    record, _ = simulate_run(configuration, "SIX", discover())
    return record


def six():
    record = value_made_once("six places and three random loads", simulated)
    recipe = load_recipe(SIX.recipe()).value
    method = create_plugin(discover(), Kind.RECONSTRUCTION, recipe.reconstruction, "[reconstruction]")
    return record, method, recipe.analysis


# --- one run ---------------------------------------------------------------------------------------------


def test_ways_begin_with_the_run_as_it_was_and_keep_places_far_apart():
    ways = DESIGN.list_ways()
    assert ways[0] == Way(9, 60.0, False)
    assert {way.places for way in ways} == {9, 6, 4, 3}
    assert {(way.hold_s, way.predicted) for way in ways} == {
        (60.0, False), (30.0, False), (15.0, False), (30.0, True), (15.0, True)
    }  # fmt: skip
    assert len(set(ways)) == len(ways)
    longer = replace(DESIGN, longest_s=240.0).list_ways()
    assert set(longer) - set(ways) == {Way(count, 60.0, True) for count in (9, 6, 4, 3)}
    assert DESIGN.choose_places(9) == DESIGN.places_mm
    assert DESIGN.choose_places(5) == ((-20.0, -20.0), (-20.0, 20.0), (0.0, 0.0), (20.0, -20.0), (20.0, 20.0))


def test_a_run_is_tried_on_its_own_frames():
    record, method, settings = six()
    trials = {trial.way: trial for trial in try_ways(record, method, settings)}
    design = read_design(record, settings)
    assert design.whole == Way(6, 25.0, False)
    assert set(trials) == set(design.list_ways())
    run = observe_run(record, method, settings, over_time=False)
    held_out = select_loads(
        run, lambda load: load.phase not in settings.calibrate_phases and load.phase != "noise figure"
    )
    learned = learn_without_tests(run).learned
    errors = [test.known_N - test.measured_N for test in force_tests(held_out, learned)]
    whole = trials[design.whole]
    assert whole.force_error_N == pytest.approx(np.sqrt(np.mean(np.square(errors))))
    assert whole.station_s == record.station_s
    # The test loads were held for a minute: the end of shorter holds must be predicted.
    assert all(trial.force_error_N < 0.5 * whole.force_error_N for way, trial in trials.items() if way.predicted)
    assert trials[replace(design.whole, hold_s=15.0)].force_error_N > whole.force_error_N


def test_what_is_left_out_takes_the_time_of_its_cycles_and_holds():
    record, _, settings = six()
    design = read_design(record, settings)
    grid = record.phase(GRID)
    assert measure_left_out_s(record, settings, design.whole, design) == pytest.approx(0, abs=1e-6)
    shorter = measure_left_out_s(record, settings, replace(design.whole, hold_s=15.0), design)
    assert shorter == pytest.approx(6 * 10.0, abs=0.1)
    fewer = measure_left_out_s(record, settings, replace(design.whole, places=3), design)
    whole_s = grid.loads[-1].rest_end_s - grid.loads[0].press_start_s
    assert fewer == pytest.approx(whole_s / 2, rel=0.2)


@pytest.mark.parametrize(("kept", "role"), [(3, Role.RANDOM), (6, Role.OTHER)])
def test_runs_with_too_little_to_leave_out_or_to_test_are_refused(kept, role):
    record, _, settings = six()
    phases = tuple(
        replace(phase, loads=phase.loads[:kept]) if phase.name == GRID
        else replace(phase, role=role) if phase.role is Role.RANDOM
        else phase
        for phase in record.phases
    )  # fmt: skip
    with pytest.raises(RefusedError, match="to leave some out and test the rest"):
        read_design(replace(record, phases=phases), settings)


# --- the choice ------------------------------------------------------------------------------------------


def made(errors, sensors=10, seed=0):
    """Trials of all ways: errors by number of places and predicted holds, alike on all sensors but for a factor."""
    random = np.random.default_rng(seed)
    factors = 1 + 0.1 * random.standard_normal(sensors)
    return {
        way: {
            f"S-{number}": StoredTrial(
                f"S-{number}", f"run {number}", way, errors(way) * factor, 60.0 * way.places + way.places * way.hold_s
            )
            for number, factor in enumerate(factors)
        }
        for way in DESIGN.list_ways()
    }


def by_places(way):
    """0.1 N with six places or more and holds of half a minute; else more."""
    return 0.1 + 0.1 * max(6 - way.places, 0) + (0.0 if way.hold_s >= 30 else 0.2) + (0.0 if way.predicted else 0.005)


def test_the_fastest_way_as_accurate_as_the_whole_runs_is_chosen_and_confirmed():
    recommended = choose_way(made(by_places), DESIGN, Target())
    assert recommended.setting == Way(6, 30.0, True).knobs
    assert recommended.seeds == 5
    assert "at most 1.2 times the force error of the most accurate" in recommended.why
    assert "on 5 sensors and again on 5 others, whose error is stated" in recommended.why
    assert recommended.accuracy[CHANGE].value < 0
    few = choose_way(made(by_places, sensors=4), DESIGN, Target())
    assert few.setting == recommended.setting
    assert "on 4 sensors that chose it" in few.why


@pytest.mark.parametrize(
    ("target", "places"),
    [(Target(force_error_N=0.33), 4), (Target(force_error_N=0.15), 6), (Target(force_error_N=0.05), None),
     (Target(budget_s=100.0), None), (Target(force_error_N=0.5, budget_s=1000.0), 3)],
)  # fmt: skip
def test_a_target_or_a_budget_is_kept(target, places):
    recommended = choose_way(made(by_places), DESIGN, target)
    assert (recommended.setting or {}).get("places") == places
    assert places is not None or recommended.why.startswith("none of ")


def test_a_way_refused_on_a_sensor_is_not_chosen():
    by_way = made(by_places)
    best = Way(6, 30.0, True)
    by_way[best]["S-1"] = replace(by_way[best]["S-1"], force_error_N=None, why="no map")
    assert choose_way(by_way, DESIGN, Target()).setting != best.knobs


def test_the_recipe_that_follows_is_that_of_the_runs_with_fewer_places(tmp_path):
    document = copy_shipped(DocumentKind.RECIPE, "nine-locations")
    recommended = choose_way(made(by_places), DESIGN, Target())
    path = tmp_path / "fewer.toml"
    write_stored_recipe(recommended, document, DESIGN, path)
    recipe = load_recipe(str(path)).value
    assert recipe.name == "fewer"
    assert path.read_text().startswith("# Written by cbsr-qa frontier")
    assert len(recipe.phases[1].options["locations_mm"]) == 6
    assert recipe.phases[1].options["hold_s"] == 30.0
    assert recipe.analysis.transients == "predicted"
    assert [phase.name for phase in recipe.phases] == [phase["name"] for phase in document["phases"]]
    two = {**document, "recipe": {**document["recipe"], "calibrate_phases": ["nine locations", "random loads"]}}
    with pytest.raises(RefusedError, match="not the only grid that calibrates"):
        write_stored_recipe(recommended, two, DESIGN, tmp_path / "two.toml")
    none = choose_way(made(by_places), DESIGN, Target(force_error_N=0.01))
    with pytest.raises(RefusedError, match="there is no recipe to write"):
        write_stored_recipe(none, document, DESIGN, tmp_path / "none.toml")


# --- the command -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--batch", "41"), "--batch is for stored runs, and --stored is missing"),
        (("--stored", "--quick"), "--quick is not for --stored"),
        (("--stored", "--recording", "x.csv"), "--recording is not for --stored"),
        (("--stored", "--force-error", "0.1"), "--force-error is '0.1'"),
    ],
)
def test_options_that_do_not_go_together_are_refused(arguments, said, capsys):
    assert run_guarded(["frontier", *arguments]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "these runs are of 3 recipes"),
        (("--of-recipe", "nine"), "no stored run is of recipe 'nine'"),
        (("--batch", "x"), "no stored run is of batch 'x'"),
    ],
)
def test_a_fleet_that_cannot_be_tried_is_named(arguments, said, capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path))
    path, _ = demo_fleet()
    assert run_guarded(["frontier", "--stored", "--database", str(path), "--json", *arguments]) == 2
    printed = capsys.readouterr()
    assert said in printed.err + json.dumps(json.loads(printed.out) if printed.out else {})
    assert FORCE == "force_error"
