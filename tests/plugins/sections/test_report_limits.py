"""The section on limits: every measurement of a run beside its limit, the worst first."""

from dataclasses import replace

from section_texts import tables, texts

from cbsr_qa.domain.plan.limits import Bound, Limit, Outcome
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa_plugins.sections.limits import Decision, Limits
from cbsr_qa_plugins.sections.relaxation import RelaxationFits


def judge(*values):
    limit = Limit("e", "mm", None, 5.0, marginal=1.0)
    about = {"phase": "nine", "how": "no blob"}
    return tuple(
        Measurement("e", value, "mm", location=f"L{k}", load=k, **about).judge(limit)
        for k, value in enumerate(values)
    )


def test_the_first_page_lists_what_was_not_met_the_worst_first(result):
    measured = judge(1.0, 4.5, 6.0, None, 9.0, 2.0)
    (table,) = tables(Decision().render(replace(result, measurements=measured)))
    assert [row[0].split(":")[0] for row in texts(table)] == ["e (L4)", "e (L2)", "e (L3)", "e (L1)"]
    assert [row[-1].outcome for row in table.rows] == [
        Outcome.FAIL,
        Outcome.FAIL,
        Outcome.NOT_MEASURED,
        Outcome.MARGINAL,
    ]


def test_the_first_page_of_a_sensor_that_met_all_limits_shows_the_closest(result):
    (table,) = tables(Decision().render(replace(result, measurements=judge(1.0, 3.0, 0.5, 2.0, 0.1))))
    assert [row[0] for row in texts(table)] == ["e (L1)", "e (L3)", "e (L0)"]


def test_the_first_page_names_how_many_more_limits_were_not_met(result):
    section = Decision().render(replace(result, measurements=judge(*[9.0] * 20)))
    assert len(tables(section)[0].rows) == 16
    assert any(getattr(block, "text", "").startswith("4 more limits") for block in section.blocks)


def test_the_first_page_says_what_the_sensor_does_only_if_it_was_calibrated(result):
    paragraphs = [getattr(block, "text", "") for block in Decision().render(result).blocks]
    assert any(text.startswith("Settles in") for text in paragraphs)
    without = Decision().render(replace(result, calibration=None))
    assert not any(getattr(block, "text", "").startswith("Settles in") for block in without.blocks)


def test_of_many_limits_the_closest_are_shown_and_the_others_folded(result):
    limit = Limit("e", "mm", None, 5.0)
    judged = tuple(
        Measurement("e", 0.05 * k, "mm", phase="nine", location="L0", load=k, strain=0.05 * (1 + k % 6)).judge(limit)
        for k in range(110)
    )
    closest, others = tables(Limits().render(replace(result, measurements=judged)))
    assert (closest.folded, others.folded) == (False, True)
    assert len(closest.rows) + len(others.rows) == 110
    failed = sum(m.outcome is Outcome.FAIL for m in judged)
    assert failed == 9
    assert [row[-1].outcome for row in closest.rows].count(Outcome.FAIL) == failed
    assert len(closest.rows) == 24
    assert texts(closest)[0][0] == "e (L0) at 10 % strain"  # the name alone would not say which press


def test_more_phases_than_fit_a_page_are_told_in_several_tables(result):
    measured = tuple(Measurement("e", float(k), "mm", phase=f"phase {k}") for k in range(9))
    parts = tables(Limits().render(replace(result, measurements=measured)))
    assert [part.columns[1:] for part in parts] == [
        tuple(f"phase {k}" for k in range(0, 3)),
        tuple(f"phase {k}" for k in range(3, 6)),
        tuple(f"phase {k}" for k in range(6, 9)),
    ]


def test_a_lower_bound_is_marked_wherever_it_is_written(result):
    about = {"phase": "nine", "location": "L0"}
    late = [Measurement("settling_time", 60.0, "s", trial=k, bound=Bound.LOWER, **about) for k in range(2)]
    common = Measurement(
        "common_settling_time", 60.0, "s", bound=Bound.LOWER, qualifier="stress, loading", how="slow"
    )
    (undecided, failed) = (common.judge(Limit(common.name, "s", None, upper)) for upper in (70.0, 50.0))
    for judged, margin in ((undecided, ""), (failed, "−10.0 s")):
        section = Limits().render(replace(result, measurements=(judged, *late, replace(late[0], bound=Bound.EXACT))))
        (row,) = texts(tables(section)[0])
        assert row[2] == "≥ 60.0\N{NO-BREAK SPACE}s"
        assert row[4].replace("\N{NO-BREAK SPACE}", " ") == margin
        assert ("slow" in row[0]) == (judged is undecided)
        assert texts(tables(section)[1])[0][1].startswith("≥ 60")
    relaxation = RelaxationFits().render(replace(result, measurements=(undecided,)))
    assert ["stress, loading", "≥ 60.0", "–", "slow"] in texts(tables(relaxation)[1])


def test_every_limit_is_listed_the_worst_first(result):
    failing = Measurement("strangers_metric", 9.0, "mm").judge(Limit("strangers_metric", "mm", None, 3.0))
    lost = Measurement("other", None, "1", how="why not").judge(Limit("other", "1", 0.0, None))
    section = Limits().render(replace(result, measurements=(*result.measurements, failing, lost)))
    rows = texts(tables(section)[0])
    assert len(rows) == sum(m.limit is not None for m in result.measurements) + 2
    assert rows[0][0] == "strangers metric"
    assert rows[0][4].startswith("−6.00")
    assert "why not" in rows[1][0]
    assert rows[1][2] == "not measured"


def test_a_strangers_measurement_is_shown_without_being_known(result):
    mine = Measurement("stickiness", 3.25, "mN", 0.4, qualifier="edge", phase="nine", location="L3", trial=0)
    section = Limits().render(replace(result, measurements=(*result.measurements, mine)))
    assert any(
        "stickiness (edge) [mN]" in row[0] and "3.2 ± 0.4" in " ".join(row) for row in texts(tables(section)[1])
    )


def test_what_could_not_be_measured_is_listed_once_with_its_reason(result):
    lost = tuple(
        Measurement("settling_time", None, "s", phase="nine", location=f"L{k}", trial=0, how=f"R² 0.{k} is too low")
        for k in range(1, 5)
    )
    section = Limits().render(replace(result, measurements=(*result.measurements, *lost)))
    (row,) = texts(tables(section)[-1])
    assert row == ["settling time", "nine", "L1, L2, L3, L4", "for example: R² 0.1 is too low"]
