"""A golden sensor against its history: changes are found, chance is not, and little history is no verdict."""

import json

import numpy as np
import pytest
from stored_lots import store_run

from cbsr_qa.app.station_check.golden_history import (
    FIGURES,
    Figure,
    GoldenHistory,
    GoldenRun,
    compare_golden,
    golden_history,
)
from cbsr_qa.domain.plan.limits import Bound
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.run.station import CheckOutcome
from cbsr_qa.store.opening import open_store

OK, WARNING, FAILED, NOT_DONE = CheckOutcome
MEANS = {name: 10.0 * (k + 1) for k, (name, _) in enumerate(FIGURES)}
QUALIFIERS = dict(FIGURES)


def values(random, **shift):
    return {name: mean + 0.1 * random.standard_normal() + shift.get(name, 0.0) for name, mean in MEANS.items()}


def measurements(of):
    return tuple(Measurement(name, float(value), "u", qualifier=QUALIFIERS[name]) for name, value in of.items())


def history(random, here=5, elsewhere=0, **shift):
    """Runs at station A, and at B and C in turn, where figures are shifted."""
    stations = ["A"] * here + [("B", "C")[k % 2] for k in range(elsewhere)]
    runs = []
    for number, station in enumerate(stations):
        of = values(random, **({} if station == "A" else shift))
        runs.append(GoldenRun(str(number), station, {name: Figure(value, 1, "u") for name, value in of.items()}))
    return GoldenHistory(tuple(runs), 0)


def compared(new, earlier):
    return {line.name: line for line in compare_golden(measurements(new), earlier, station="A", subject="golden G")}


def test_a_figure_that_changed_fails_and_the_others_do_not():
    random = np.random.default_rng(2)
    found = compared(values(random, force=3.0), history(random, here=8))
    assert [name for name, line in found.items() if line.outcome is FAILED] == ["force"]
    line = found["force"]
    assert line.said.startswith("here 10.0")
    assert line.said.endswith(" in 8 earlier runs")
    assert "second golden sensor" in line.remedy
    assert found["history"].said == "8 earlier runs at this station, 0 at others"
    assert line.subject == "golden G"


def test_a_station_is_held_against_others_apart_from_itself():
    random = np.random.default_rng(3)
    # Station A has always read 3 more force than the others: it repeats itself, and is not like them.
    found = compared(values(random), history(random, here=8, elsewhere=8, force=-3.0))
    assert found["force"].outcome is FAILED
    assert found["force"].allowed.count("(here)") == found["force"].allowed.count("(B, C)") == 1
    assert found["force"].said.startswith("here 10.")
    assert "; B, C 7." in found["force"].said
    assert found["area overlap"].outcome is OK


@pytest.mark.parametrize("earlier", [0, 1, 2])
def test_fewer_than_three_earlier_runs_are_no_verdict(earlier):
    random = np.random.default_rng(4)
    found = compared(values(random, force=100.0), history(random, here=earlier))
    assert {line.outcome for line in found.values()} == {NOT_DONE}
    assert found["force"].said == "fewer than 3 earlier runs to compare with"
    assert found["force"].value == pytest.approx(110.0, abs=1.0)
    assert "no verdict" in found["history"].remedy


@pytest.mark.parametrize(("runs", "deviations"), [(3, 38.3), (5, 9.7), (10, 5.1)])
def test_intervals_reach_as_far_as_the_documentation_says(runs, deviations):
    random = np.random.default_rng(9)
    earlier = history(random, runs)
    of = [run.figures["force"].value for run in earlier.runs]
    reach = deviations * np.std(of, ddof=1)
    for outside, outcome in ((1.03, FAILED), (0.97, WARNING)):
        new = {**values(random), "force": float(np.mean(of)) + outside * reach}
        assert compared(new, earlier)["force"].outcome is outcome


@pytest.mark.rest
def test_while_nothing_changes_one_check_in_a_hundred_fails_and_one_in_twenty_says_anything():
    random, trials, failed, said = np.random.default_rng(5), 400, 0, 0
    for _ in range(trials):
        outcomes = {line.outcome for line in compared(values(random), history(random, here=5)).values()}
        failed += FAILED in outcomes
        said += bool(outcomes & {FAILED, WARNING})
    # Bonferroni is a bound: 1 % and 5 % at most, and not far below for figures that do not hang together.
    assert failed / trials <= 0.01 + 3 * np.sqrt(0.01 / trials)
    assert 0.02 <= said / trials <= 0.05 + 3 * np.sqrt(0.05 / trials)


def test_a_figure_of_several_places_is_their_mean_and_of_other_places_is_not_compared():
    random = np.random.default_rng(6)
    new = measurements({name: value for name, value in values(random).items() if name != "force"})
    new += tuple(Measurement("force", f, "u", location=f"L{k}") for k, f in enumerate((9.0, 10.0, 11.0)))
    one_place = history(random)
    lines = {line.name: line for line in compare_golden(new, one_place, station="A", subject="")}
    assert (lines["force"].value, lines["force"].outcome) == (10.0, NOT_DONE)


def test_what_was_not_measured_this_time_is_said():
    random = np.random.default_rng(7)
    new = [m for m in measurements(values(random)) if m.name not in ("force", "drift")]
    new += [Measurement("force", None, "u", how="no load cell"), Measurement("drift", 1.0, "u", bound=Bound.LOWER)]
    for earlier, outcome in ((2, NOT_DONE), (3, FAILED)):  # what was measured before and is not now has changed
        lines = {line.name: line for line in compare_golden(new, history(random, earlier), station="A", subject="")}
        for name in ("force", "drift"):
            assert (lines[name].outcome, lines[name].value) == (outcome, None)
            assert lines[name].said.startswith("it could not be measured in this run")


def test_figures_that_never_varied_hold_what_is_equal_and_nothing_else():
    same = GoldenRun("1", "A", {name: Figure(mean, 1, "u") for name, mean in MEANS.items()})
    earlier = GoldenHistory((same,) * 4, 0)
    assert compared(MEANS, earlier)["force"].outcome is OK
    assert compared({**MEANS, "force": 10.5}, earlier)["force"].outcome is FAILED


@pytest.mark.rest
def test_earlier_runs_are_those_of_the_same_recipe_that_were_finished(tmp_path):
    force = (Measurement("force", 3.6, "N"), Measurement("channel_snr", 58.0, "dB", qualifier="median"))
    golden = {"recipe": "golden-check"}
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}", durable=False) as store:
        first = store_run(store, "G-1", force, **golden)
        store_run(store, "G-1", force, recipe="nine-locations")
        store_run(store, "G-2", force, **golden)
        store_run(store, "G-1", force, **golden, end=EndReason.ABORTED)
        store_run(store, "G-1", force, **golden, tables={"phases": [{"hold_s": 60}]})
        second = store_run(store, "G-1", force, **golden, station="bench-β", day=3)
        new = store_run(store, "G-1", force, **golden, day=5)
        store_run(store, "G-1", force, **golden, day=6)
        found = golden_history(store, new)
        assert [(run.run, run.station) for run in found.runs] == [(first, "bench-α"), (second, "bench-β")]
        assert found.unlike == 1
        assert found.runs[0].figures["channel_snr"] == Figure(58.0, 1, "dB")
        assert json.loads(store.runs.read_configuration(new))["seed"] == 5  # another seed is no other recipe
