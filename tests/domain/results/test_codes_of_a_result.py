"""Failure codes of a run's result: by the narrowest name, the worst first, in its report and its JSON."""

from dataclasses import replace
from datetime import UTC, datetime

import pytest
from report_samples import sample_run

from cbsr_qa.app.run.outcome import RunOutcome, run_outcome
from cbsr_qa.domain.plan.limits import FailureCode, Limit, Outcome, choose_disposition, select_failure_codes
from cbsr_qa.domain.results.measurement import Measurement, Verdict, decide
from cbsr_qa.domain.run.changes import VerdictOverride
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.report.document import json_document
from cbsr_qa.report.heads import run_page
from cbsr_qa.report.render import render_run
from cbsr_qa.report.terminal import terminal_lines
from cbsr_qa_plugins.sections.limits import Decision, Limits

CODES = (
    FailureCode("E1", "loose electrode", "rework: check pin", ("channel_snr",)),
    FailureCode("P1", "wrong place", "retest", ("centre_of_mass_error",)),
    FailureCode("P2", "wrong place by chance", "retest", ("centre_of_mass_error (random loads)",)),
    FailureCode("M1", "not judged", "", ("not measured",)),
    FailureCode("M2", "stopped", "retest", ("aborted",)),
)


def measured(*errors_by_phase, snr=50.0):
    limits = {"mm": Limit("centre_of_mass_error", "mm", None, 6.0), "dB": Limit("channel_snr", "dB", 40.0, None)}
    errors = [Measurement("centre_of_mass_error", error, "mm", phase=phase) for phase, error in errors_by_phase]
    return tuple(m.judge(limits[m.unit]) for m in (*errors, Measurement("channel_snr", snr, "dB", how="no frames")))


@pytest.fixture(scope="module")
def result():
    return replace(sample_run(), coded=CODES)


def override(outcome):
    at = datetime(2026, 3, 2, tzinfo=UTC)
    return VerdictOverride("o", "run", "a", Outcome.FAIL, outcome, "Ada", at, "the head was bent")


def codes_of(result, measurements, **changes):
    judged = replace(result, measurements=measurements, verdict=decide(measurements))
    return replace(judged, **changes).failure_codes


def test_the_narrowest_name_counts_and_the_worst_failure_is_first(result):
    failed = measured(("nine locations", 7.0), ("random loads", 30.0), snr=30.0)
    assert [(code.code, code.causes) for code in codes_of(result, failed)] == [
        ("P2", ("centre_of_mass_error (random loads)",)),
        ("E1", ("channel_snr",)),
        ("P1", ("centre_of_mass_error",)),
    ]


def test_a_code_is_given_once_with_all_that_gave_it(result):
    codes = (FailureCode("X", "bad", "scrap", ("centre_of_mass_error (a)", "channel_snr", "drift")),)
    (code,) = codes_of(replace(result, coded=codes), measured(("a", 7.0), ("a", 8.0), snr=39.0))
    assert code.causes == ("centre_of_mass_error (a)", "channel_snr")


def test_a_pass_has_none_and_what_was_not_measured_has_its_rule(result):
    assert codes_of(result, measured(("a", 1.0))) == ()
    assert [code.code for code in codes_of(result, measured(("a", 1.0), snr=None))] == ["M1"]
    failed_too = codes_of(result, measured(("a", 7.0), snr=None))
    assert [code.code for code in failed_too] == ["P1"]


@pytest.mark.parametrize(
    ("end", "missing", "codes"),
    [(EndReason.ABORTED, False, ["M2"]), (EndReason.BROKEN, False, ["M1"]), (EndReason.ABORTED, True, ["M2"]),
     (EndReason.FINISHED, True, [])],
)  # fmt: skip
def test_an_end_has_its_rule_or_that_of_what_was_not_measured(result, end, missing, codes):
    ended = replace(
        result,
        measurements=(),
        record=replace(result.record, end=end),
        verdict=Verdict(Outcome.NOT_MEASURED, "stopped"),
        missing=missing,
    )
    assert [code.code for code in ended.failure_codes] == codes


def test_report_terminal_and_json_show_code_and_disposition(result):
    failed = measured(("nine locations", 7.0))
    judged = replace(result, measurements=failed, verdict=decide(failed))
    assert run_page(judged).banner.actions == ("P1 wrong place: retest",)
    (table,) = [block for block in Limits().blocks(judged) if getattr(block, "columns", ())]
    assert table.columns[-1] == "Code"
    assert [row[-1].text for row in table.rows] == ["P1 wrong place: retest", ""]
    (on_page_one,) = [block for block in Decision().blocks(judged) if getattr(block, "columns", ())]
    assert on_page_one.rows[0][-1].text == "P1"
    told = run_outcome(RunOutcome.from_result(judged))
    assert any("P1 wrong place: retest" in line for line in terminal_lines(told.page, told.sections))
    assert json_document(told.result)["failure_codes"] == [
        {
            "code": "P1",
            "text": "wrong place",
            "disposition": "retest",
            "causes": ["centre_of_mass_error"],
            "disposition_again": "",
            "failed_before": 0,
        }
    ]


@pytest.mark.parametrize(
    ("again", "before", "todo"),
    [
        ("scrap", (), "retest"),
        ("scrap", ("E1",), "retest"),
        ("scrap", ("P1", "E1"), "scrap (it has failed 2 times with P1)"),
        ("scrap", ("P1", "P1"), "scrap (it has failed 3 times with P1)"),
        ("", ("P1",), "retest (it has failed 2 times with P1)"),
    ],
)
def test_a_sensor_that_fails_again_with_a_code_has_the_disposition_for_that(result, again, before, todo):
    codes = tuple(replace(code, disposition_again=again if code.code == "P1" else "") for code in CODES)
    failed = measured(("nine locations", 7.0))
    judged = replace(result, coded=codes, failed_before=before, measurements=failed, verdict=decide(failed))
    assert [code.todo for code in judged.failure_codes] == [todo]
    assert run_page(judged).banner.actions == (f"P1 wrong place: {todo}",)
    assert judged.codes_of(failed[0])[0].todo == todo


def test_what_a_repeated_failure_asks_for_counts_before_the_worst():
    worst, repeated = CODES[0], replace(CODES[1], disposition_again="scrap", failed_before=1)
    assert choose_disposition((worst, CODES[1])) == "rework: check pin"
    assert choose_disposition((worst, repeated)) == "scrap (it has failed 2 times with P1)"
    assert choose_disposition((worst, replace(repeated, disposition_again=""))) == "rework: check pin"
    assert choose_disposition((CODES[3],)) == ""


def test_a_report_without_codes_has_no_column(result):
    failed = measured(("nine locations", 7.0))
    bare = replace(result, measurements=failed, verdict=decide(failed), coded=())
    (table,) = [block for block in Limits().blocks(bare) if getattr(block, "columns", ())]
    assert "Code" not in table.columns


def test_a_recipe_without_codes_gives_none():
    assert select_failure_codes((), Outcome.FAIL, "finished", [("drift", "", "")]) == ()


def test_the_box_of_the_verdict_says_what_to_do_unless_somebody_let_the_sensor_through(result):
    failed = measured(("nine locations", 7.0))
    judged = replace(result, measurements=failed, verdict=decide(failed))
    box = render_run(judged, []).partition('class="banner fail"')[2].partition("</div>")[0]
    assert "P1 wrong place: retest" in box
    changed = replace(judged, overrides=(override(Outcome.PASS),))
    assert run_page(changed).banner.actions == ()
    assert ("Failure code", "P1 wrong place: retest") in run_page(changed).identity
    assert run_page(replace(judged, overrides=(override(Outcome.FAIL),))).banner.actions
