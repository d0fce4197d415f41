"""``frontier --stored``: runs analysed again with fewer places and shorter holds, the choice, and the recipe."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from batches import RADIUS_MM, draw_batch
from demo_fleet import demo_fleet
from made_once import value_made_once

from cbsr_qa.analysis.run.force import force_tests, learn_without_tests
from cbsr_qa.analysis.run.observe import observe_run
from cbsr_qa.calibration.batch.kept import keep_loads, make_prior
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.report import Figure
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.studies.batch.sensors import map_loads
from cbsr_qa.studies.frontier.point import BatchAsPrior
from cbsr_qa.studies.frontier.recommend import Target
from cbsr_qa.studies.frontier.setting import GRID, Setting
from cbsr_qa.studies.frontier.stored import batch as batch_of_runs, study
from cbsr_qa.studies.frontier.stored.batch import StoredBatch, learn_others
from cbsr_qa.studies.frontier.stored.report import lay_out_stored
from cbsr_qa.studies.frontier.stored.study import (
    CHANGE,
    FORCE,
    Pieces,
    choose_way,
    compare_pairs,
    make_points,
    try_batch,
    write_stored_recipe,
)
from cbsr_qa.studies.frontier.stored.trial import Design, StoredTrial, Way, measure_left_out_s, read_design, try_ways
from cbsr_qa.studies.frontier.study import Frontier
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


def test_ways_with_a_batch_are_those_of_holds_as_long_as_the_batch_s():
    ways = DESIGN.list_batch_ways()
    assert {way.prior for way in ways} == {"batch"}
    assert {replace(way, prior="none") for way in ways} < set(DESIGN.list_ways())
    assert {way.hold_s for way in ways if not way.predicted} == {60.0}


def test_the_others_of_a_batch_teach_a_sensor_what_its_own_presses_do_not():
    """In a batch that responds as it does, three presses say what six say; one of other sensors is not used."""
    record, method, settings = six()
    run = observe_run(record, method, replace(settings, transients="predicted"), over_time=False)
    loads = map_loads(run, learn_without_tests(run))
    random = np.random.default_rng(4)

    def keep(response):
        """A batch of six sensors that respond like this."""
        sensors = [
            keep_loads(f"B-{n}", f"r{n}", "0" * 64, replace(loads, log_response=response + random.normal(0, 0.01, 6)))
            for n in range(6)
        ]
        return learn_others(StoredBatch((), "41", "disc-100mm", "cbsr-8wt", 13.0, RADIUS_MM), sensors, ["new"])["new"]

    few = Way(3, 15.0, True, "batch")
    without = {trial.way: trial.force_error_N for trial in try_ways(record, method, settings)}
    alike = {trial.way: trial for trial in try_ways(record, method, settings, keep(loads.log_response))}
    assert set(alike) == set(read_design(record, settings).list_batch_ways())
    alone = replace(few, prior="none")
    assert alike[few].force_error_N == pytest.approx(alike[replace(few, places=6)].force_error_N, rel=0.01)
    assert without[alone] != pytest.approx(without[replace(alone, places=6)], rel=0.1)
    unlike = random.standard_normal(len(loads.log_response))
    stranger = {trial.way: trial for trial in try_ways(record, method, settings, keep(unlike))}
    assert stranger[few].force_error_N == pytest.approx(without[alone])


# --- the batch -------------------------------------------------------------------------------------------


def kept_sensors(rho=0.9, count=8):
    sensors, _ = draw_batch(np.random.default_rng(3), rho, sensors=count)
    return [keep_loads(f"S-{number}", f"run {number}", "0" * 64, loads) for number, loads in enumerate(sensors)]


def test_a_sensor_has_no_part_in_the_model_that_it_is_tried_with():
    sensors = kept_sensors()
    batch = StoredBatch((), "41", "disc-100mm", "cbsr-8wt", 13.0, RADIUS_MM)
    models = learn_others(batch, sensors, ["S-0", "S-5", "new"])
    assert [sensor.serial for sensor in models["S-5"].sensors] == [f"S-{n}" for n in (0, 1, 2, 3, 4, 6, 7)]
    assert len(models["new"].sensors) == 8
    assert len({model.digest for model in models.values()}) == 3
    # What only its own loads say does not reach it.
    changed = [replace(sensor, log_response=tuple(v + 0.3 for v in sensor.log_response)) if n == 5 else sensor
               for n, sensor in enumerate(sensors)]  # fmt: skip
    again = learn_others(batch, changed, ["S-5"])["S-5"]
    place = np.array([[5.0, 5.0]])
    one, other = (make_prior(model).predict(place)[0] for model in (models["S-5"], again))
    assert one == pytest.approx(other, abs=0.02)


@pytest.mark.parametrize(
    ("batches", "serials", "said"),
    [
        (("41", "41", "42"), 8, "several batches or of none (41, 42)"),
        (("", ""), 8, "several batches or of none (none stated)"),
        (("41",), 5, "4 other sensors can be learned from where a sensor is left out, and 5 are needed"),
    ],
)
def test_why_a_batch_is_no_prior_is_said(batches, serials, said, monkeypatch):
    runs = [SimpleNamespace(serial=f"S-{number}", batch=batch) for number, batch in enumerate(batches)]
    records = tuple(
        SimpleNamespace(identity=SimpleNamespace(sensor=SimpleNamespace(serial=f"S-{number}"), run=f"run {number}"))
        for number in range(serials)
    )
    monkeypatch.setattr(batch_of_runs, "choose_runs", lambda *_: (records, ()))
    with pytest.raises(RefusedError) as refused:
        batch_of_runs.find_batch(None, RunSelection(), runs)
    assert said in refused.value.reason


class InLine(Pieces):
    """Pieces that are computed at once, and not kept."""

    def __init__(self):
        self.keys = []

    def collect(self, kind, work):
        self.keys += [key for key, _, _ in work]
        return [result for _, _, run in work for result in run()]


@pytest.mark.parametrize(("silent", "told"), [(0, True), (3, False)])
def test_every_run_is_tried_with_the_model_of_the_others(silent, told, monkeypatch):
    sensors = {sensor.run: sensor for sensor in kept_sensors()}
    models = {}
    monkeypatch.setattr(
        study, "plan_observation", lambda url, run: lambda: [sensors[run]] if int(run[4:]) >= silent else []
    )
    monkeypatch.setattr(study, "plan_trial", lambda url, run, model: lambda: models.update({run: model}) or [run])
    batch = StoredBatch(
        tuple((sensor.serial, run) for run, sensor in sensors.items()),
        "41",
        "disc-100mm",
        "cbsr-8wt",
        13.0,
        RADIUS_MM,
    )
    runs = [SimpleNamespace(serial=sensor.serial, run=run, words=run) for run, sensor in sensors.items()]
    compute = InLine()
    trials, prior = try_batch(batch, runs, "", compute)
    assert prior.sensors == 8 - silent
    assert bool(prior.why) != told
    assert trials == (list(sensors) if told else [])
    assert all({other.run for other in model.sensors} == set(sensors) - {run} for run, model in models.items())
    assert len(set(compute.keys)) == len(compute.keys)


def with_batch(gain, sensors=10):
    """Trials of all ways: with the batch as prior the error of few places falls by a factor."""
    by_way = made(by_places, sensors)
    for way in DESIGN.list_batch_ways():
        without = by_way[replace(way, prior="none")]
        by_way[way] = {
            serial: replace(trial, way=way, force_error_N=0.1 + gain * (trial.force_error_N - 0.1))
            for serial, trial in without.items()
        }
    return by_way


def test_pairs_say_what_the_batch_changes_with_an_interval_over_the_sensors():
    points = make_points(with_batch(0.2), DESIGN)
    changes = {(change.places, change.hold_s, change.transients): change for change in compare_pairs(points)}
    assert len(changes) == len(DESIGN.list_batch_ways())
    change = changes[3, 15.0, "predicted"]
    assert change.change_N == pytest.approx(change.with_N - change.without_N)
    errors = [0.8 * (trial.force_error_N - 0.1) for trial in made(by_places)[Way(3, 15.0, True)].values()]
    tail = 2.262 * np.std(errors, ddof=1) / np.sqrt(10)
    assert change.low_N == pytest.approx(-np.mean(errors) - tail, rel=1e-3)
    assert change.high_N == pytest.approx(-np.mean(errors) + tail, rel=1e-3)


@pytest.mark.parametrize(("gain", "setting"), [(0.0, Way(3, 15.0, True, "batch")), (1.0, Way(6, 30.0, True))])
def test_the_batch_is_recommended_where_it_saves_places_and_not_where_it_changes_nothing(gain, setting, tmp_path):
    recommended = choose_way(with_batch(gain), DESIGN, Target(force_error_N=0.15))
    assert recommended.setting == setting.knobs
    path = tmp_path / "few.toml"
    write_stored_recipe(recommended, copy_shipped(DocumentKind.RECIPE, "nine-locations"), DESIGN, path)
    assert load_recipe(str(path)).value.analysis.prior == setting.prior
    assert ("cbsr-qa batch model" in path.read_text()) == (setting.prior == "batch")


def test_the_batch_is_not_recommended_for_a_gain_that_may_be_chance():
    """It is smaller on average with the batch, and so on six of ten sensors only."""
    by_way = with_batch(1.0)
    for way in DESIGN.list_batch_ways():
        by_way[way] = {
            serial: replace(trial, force_error_N=trial.force_error_N + (-0.05 if number < 6 else 0.06))
            for number, (serial, trial) in enumerate(by_way[way].items())
        }
    assert choose_way(by_way, DESIGN, Target()).setting["prior"] == "none"


def test_the_page_shows_pairs_and_what_is_not_known():
    by_way = with_batch(0.2)
    points = tuple(make_points(by_way, DESIGN))
    recommended = choose_way(by_way, DESIGN, Target())
    prior = BatchAsPrior(10, "", tuple(compare_pairs(points)))
    outcome = lay_out_stored(Frontier(False, points, recommended, batch=prior))
    last = outcome.sections[-1]
    assert last.title == "The batch as prior"
    assert len(last.blocks[0].rows) == len(DESIGN.list_batch_ways())
    assert "adaptive-batch" in last.blocks[1].text
    drawing = next(block for block in outcome.sections[0].blocks if isinstance(block, Figure)).svg()
    assert "batch as prior" in drawing
    untold = replace(outcome.result, batch=BatchAsPrior(4, "4 other sensors can be learned from"))
    (only,) = lay_out_stored(untold).sections[-1].blocks
    assert "the batch as prior would have cost is not known: 4 other sensors" in only.text


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
