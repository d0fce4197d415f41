"""The verdict of each location: worst of what was judged there, in words and as a picture."""

from dataclasses import replace

import pytest
from report_samples import sample_run
from sensor_samples import SENSOR

from cbsr_qa.domain.plan.limits import Limit, Outcome
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.results.report import Figure
from cbsr_qa.report.draw.images import verdict_figure
from cbsr_qa.report.location_verdicts import location_verdicts, outcome_counts, verdicts_in_words
from cbsr_qa.report.svg import check_svg
from cbsr_qa_plugins.sections.limits import Limits


@pytest.fixture(scope="module")
def run():
    return sample_run(size_mm=6.0).observation


def measured(run, phase, index, value, *, name="error", upper=2.0, marginal=0.5):
    load = next(one.record for one in run.loads if (one.phase, one.record.index) == (phase, index))
    found = Measurement(
        name, value, "mm", phase=phase, location=load.load.label, load=index, how="" if value is not None else "lost"
    )
    return found.judge(Limit(name, "mm", None, upper, marginal))


def test_the_worst_outcome_of_a_place_is_its_verdict(run):
    judged = [
        measured(run, "nine", 0, 1.0),
        measured(run, "nine", 0, 3.0, name="other"),
        measured(run, "nine", 0, 9.0),
        measured(run, "nine", 1, 1.7),
        measured(run, "nine", 2, 0.1),
        measured(run, "nine", 3, None),
    ]
    found = {one.label: one for one in location_verdicts(run, judged)}
    outcomes = {label: one.outcome for label, one in found.items()}
    assert outcomes == {"L0": Outcome.FAIL, "L1": Outcome.MARGINAL, "L2": Outcome.PASS, "L3": Outcome.NOT_MEASURED}
    assert (found["L0"].deciding.value, found["L0"].judged) == (9.0, 3)


def test_trials_of_one_place_are_one_verdict_and_phases_are_apart(run):
    judged = [measured(run, "noise", k, 1.0) for k in range(3)] + [measured(run, "nine", 0, 5.0)]
    found = [(one.phase, one.label, one.outcome) for one in location_verdicts(run, judged)]
    assert found == [("noise", "L0", Outcome.PASS), ("nine", "L0", Outcome.FAIL)]


def test_what_is_not_about_one_load_is_no_places(run):
    whole = Measurement("noise_figure", 9.0, "1").judge(Limit("noise_figure", "1", None, 2.0))
    assert location_verdicts(run, [whole]) == ()
    lost = replace(measured(run, "nine", 0, 1.0), load=99)
    assert location_verdicts(run, [lost]) == ()


def test_words_name_the_worst_first_and_count_the_rest(run):
    judged = [measured(run, "nine", k, 1.9 if k == 1 else 4.0 if k == 4 else 0.2) for k in range(9)]
    words = verdicts_in_words(location_verdicts(run, judged))
    assert words.startswith("By location, 2 do not simply pass: L4 (nine) fail, error 4")
    assert "L1 (nine) marginal" in words
    assert words.endswith("The other 7 pass.")
    assert verdicts_in_words(location_verdicts(run, judged[5:])) == "By location: all 4 pass."


def test_a_value_that_is_lacking_is_named_with_its_reason(run):
    words = verdicts_in_words(location_verdicts(run, [measured(run, "nine", 3, None)]))
    assert "L3 (nine) not measured, error: lost" in words


@pytest.mark.parametrize(
    "phases",
    [
        ("nine",),
        pytest.param(("nine", "random"), marks=pytest.mark.rest),
        pytest.param(("noise", "nine", "random", "relaxation"), marks=pytest.mark.rest),
    ],
)
@pytest.mark.parametrize("value", [0.1, 1.8, 50.0, None])
def test_the_picture_says_outcomes_without_colour(run, phases, value):
    judged = [measured(run, load.phase, load.record.index, value) for load in run.loads if load.phase in phases]
    verdicts = location_verdicts(run, judged)
    figure = verdict_figure(verdicts, SENSOR)
    check_svg(figure)
    sign, word = {0.1: ("✓", "pass"), 1.8: ("≈", "marginal"), 50.0: ("✗", "fail"), None: ("?", "not measured")}[value]
    assert figure.count(f">{sign}") == len(verdicts)
    assert f" {word}</text>" in figure
    assert outcome_counts([verdict.outcome for verdict in verdicts]) == f"{len(verdicts)} {word}"


def test_the_section_shows_it_where_loads_are_judged(run):
    result = sample_run(size_mm=6.0)
    assert any(isinstance(block, Figure) for block in Limits().render(result).blocks)
    whole = tuple(m for m in result.measurements if m.load is None)
    assert not any(isinstance(block, Figure) for block in Limits().render(replace(result, measurements=whole)).blocks)
