"""Reports rendered again: the seam to whatever rebuilds a result, and the order of sections."""

import json
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
from report_samples import sample_run

from cbsr_qa.app.run.render import render_result
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.plugin.discovery import discover

SECTIONS = ("limits", "traceability")


@pytest.fixture(scope="module")
def result():
    return sample_run(size_mm=8.0, serial="../../<SN> 42")


def test_a_report_is_written_under_a_safe_name_in_the_folder_alone(result, tmp_path):
    rendered = render_result(result, SECTIONS, discover(), tmp_path / "reports")
    assert rendered.report.parent == tmp_path / "reports"
    assert [path.name for path in rendered.report.parent.iterdir()] == [rendered.report.name]
    assert rendered.outcome == str(result.verdict.outcome)
    html = rendered.report.read_text(encoding="utf-8")
    assert html.index("Limits and measurements") < html.index("Traceability")
    assert "Random loads" not in html


def test_rendering_twice_changes_no_byte(result, tmp_path):
    first = render_result(result, SECTIONS, discover(), tmp_path).report.read_bytes()
    again = render_result(result, SECTIONS, discover(), tmp_path).report.read_bytes()
    assert first == again


def test_a_section_that_is_not_installed_is_a_warning_in_the_report(result, tmp_path):
    rendered = render_result(result, ("limits", "strangers"), discover(), tmp_path)
    assert "strangers" in rendered.report.read_text(encoding="utf-8")
    assert any("strangers" in warning for warning in rendered.warnings)


def test_what_the_page_warns_of_is_in_the_document_too(result, tmp_path, monkeypatch, capsys):
    warned = replace(result, warnings=("its rows are not chained",))
    monkeypatch.setattr("cbsr_qa.app.run.render.open_store", lambda *_, **__: nullcontext(Mock()))
    monkeypatch.setattr("cbsr_qa.app.run.render.rebuilt", lambda *_: (warned, SECTIONS))
    monkeypatch.setattr("cbsr_qa.app.run.render.write_calibration", lambda *_: None)
    assert run_guarded(["report", "S-1", "--to", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == ["its rows are not chained"]


def test_a_folder_in_the_way_is_refused(result, tmp_path):
    Path(tmp_path / "reports").write_text("a file")
    with pytest.raises(RefusedError, match="reports"):
        render_result(result, SECTIONS, discover(), tmp_path / "reports")
