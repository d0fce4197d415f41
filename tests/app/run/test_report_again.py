"""Reports rendered again: the seam to whatever rebuilds a result, and the order of sections."""

import json
import re
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
from report_samples import sample_run

from cbsr_qa.app.run.render import render_result
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.report.section import LEADING, Annexes

ANNEXES = Annexes(("limits", "random-loads"))


@pytest.fixture(scope="module")
def result():
    return sample_run(size_mm=8.0, serial="../../<SN> 42")


def test_a_report_is_written_under_a_safe_name_in_the_folder_alone(result, tmp_path):
    rendered = render_result(result, ANNEXES, discover(), tmp_path / "reports")
    assert rendered.report.parent == tmp_path / "reports"
    assert [path.name for path in rendered.report.parent.iterdir()] == [rendered.report.name]
    assert rendered.outcome == str(result.verdict.outcome)
    html = rendered.report.read_text(encoding="utf-8")
    assert html.index("Traceability") < html.index("Limits and measurements") < html.index("Random loads")
    assert "Masks compared" not in html


def test_rendering_twice_changes_no_byte(result, tmp_path):
    first = render_result(result, ANNEXES, discover(), tmp_path).report.read_bytes()
    again = render_result(result, ANNEXES, discover(), tmp_path).report.read_bytes()
    assert first == again


def test_a_section_that_is_not_installed_is_a_warning_in_the_report(result, tmp_path):
    rendered = render_result(result, Annexes(("limits", "strangers")), discover(), tmp_path)
    assert "strangers" in rendered.report.read_text(encoding="utf-8")
    assert any("strangers" in warning for warning in rendered.warnings)


def test_what_the_page_warns_of_is_in_the_document_too(result, tmp_path, monkeypatch, capsys):
    warned, recipe = replace(result, warnings=("its rows are not chained",)), Mock(sections=(), annexes_if_passed=())
    monkeypatch.setattr("cbsr_qa.app.run.render.open_store", lambda *_, **__: nullcontext(Mock()))
    monkeypatch.setattr("cbsr_qa.app.run.render.rebuilt", lambda *_: (warned, recipe))
    monkeypatch.setattr("cbsr_qa.app.run.render.write_calibration", lambda *_: None)
    assert run_guarded(["report", "S-1", "--to", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == ["its rows are not chained"]


def test_a_folder_in_the_way_is_refused(result, tmp_path):
    Path(tmp_path / "reports").write_text("a file")
    with pytest.raises(RefusedError, match="reports"):
        render_result(result, ANNEXES, discover(), tmp_path / "reports")


def test_the_first_pages_decide_show_and_trace_and_the_annexes_follow(result, tmp_path):
    html = render_result(result, ANNEXES, discover(), tmp_path).report.read_text()
    titles = re.findall(r"<h[23]>(?:<.*?</span> )?(.*?)</h[23]>", html)
    assert titles[-7:] == [
        "Decision",
        "What was measured",
        "Station",
        "Traceability",
        "Annexes",
        "Limits and measurements",
        "Random loads",
    ]
    assert html.count('class="leading leaf"') == 2  # pages two and three begin on a new sheet
    assert html.count('<details class="annex"') == 2
    assert 'class="annex" id="s6" open' not in html


def test_annexes_that_were_asked_for_are_open_and_none_leaves_three_pages(result, tmp_path):
    plugins = discover()
    opened = render_result(result, Annexes.from_request(["limits"], plugins), plugins, tmp_path).report.read_text()
    assert re.findall(r'<details class="annex" id="\w+"( open)?>', opened) == [" open"]
    bare = render_result(result, Annexes.from_request(["none"], plugins), plugins, tmp_path).report.read_text()
    assert "Annexes" not in bare
    assert "Traceability" in bare
    every = Annexes.from_request(["all"], plugins).list_sections(plugins)
    assert every[:4] == LEADING
    assert set(every) == set(plugins.list_names(Kind.SECTION))
    with pytest.raises(RefusedError, match="--annex imges: there is no such section"):
        Annexes.from_request(["limits", "imges"], plugins)
    with pytest.raises(RefusedError, match="--annex none is given beside others"):
        Annexes.from_request(["limits", "none"], plugins)


@pytest.mark.parametrize(
    ("outcome", "wanted", "names"),
    [
        (Outcome.PASS, ("force",), ("force",)),
        (Outcome.PASS, (), None),
        (Outcome.PASS, None, ("limits", "force")),
        (Outcome.MARGINAL, ("force",), ("limits", "force")),
        (Outcome.FAIL, ("force",), ("limits", "force")),
    ],
)
def test_only_a_sensor_that_passed_has_fewer_annexes(outcome, wanted, names):
    recipe = Mock(sections=("limits", "force"), annexes_if_passed=wanted)
    assert Annexes.from_recipe(recipe, outcome) == Annexes(names)
