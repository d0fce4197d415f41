"""From a stored run to a verdict, whatever the run or a plugin was like."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from cbsr_qa.analysis.evaluate import evaluate_run
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.system.clock import Stages

_RECIPE = load_recipe("nine-locations").value


@pytest.mark.parametrize(("end", "said"), [(EndReason.ABORTED, "aborted: by Anna"), (EndReason.BROKEN, "broken")])
def test_a_run_that_did_not_finish_is_not_measured(end, said):
    record = SimpleNamespace(end=end, end_detail="by Anna")
    conclusion = evaluate_run(record, _RECIPE, discover(), Stages())
    assert conclusion.verdict.outcome is Outcome.NOT_MEASURED
    assert said in conclusion.verdict.reason
    assert conclusion.measurements == ()


def test_whatever_a_reconstruction_raises_the_run_is_not_measured_and_says_why(monkeypatch):
    def broken(record, reconstruction, settings):
        raise ValueError("a stranger's mistake")

    monkeypatch.setattr("cbsr_qa.analysis.evaluate.observe_run", broken)
    record = SimpleNamespace(end=EndReason.FINISHED, end_detail="")
    conclusion = evaluate_run(record, _RECIPE, discover(), Stages())
    assert conclusion.verdict.outcome.exit_code == 3
    assert "ValueError: a stranger's mistake" in conclusion.verdict.reason


def test_the_overlap_threshold_is_the_main_masks_where_the_sensor_is_calibrated():
    from cbsr_qa.analysis.evaluate import _overlap_threshold
    from cbsr_qa.domain.plan.limits import Limit

    def limit(lower, phase="", qualifier=""):
        return Limit("area_overlap", "%", lower, None, phase=phase, qualifier=qualifier)

    others = (limit(90, phase="random loads"), limit(95, qualifier="mask 25 %"))
    assert _overlap_threshold(replace(_RECIPE, limits=(*others, limit(60, phase="nine locations")))) == 60
    assert _overlap_threshold(replace(_RECIPE, limits=others)) == 50  # where the second band begins
    one_band = replace(_RECIPE.analysis, overlap_bands=_RECIPE.analysis.overlap_bands[:1])
    assert _overlap_threshold(replace(_RECIPE, limits=(), analysis=one_band)) == 0
