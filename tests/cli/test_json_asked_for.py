"""A document is printed where one was asked for: "--json" may also be the value of another option."""

import json

import pytest

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import LONGEST_PROBLEM, BrokenRunError, RowProblem


def refused(capsys, *more):
    arguments = ["verdict", "override", "nothing", "--outcome", "pass", "--by", "Ada"]
    assert run_guarded([*arguments, "--database", "gone.db", *more]) == 2
    return capsys.readouterr()


def test_a_reason_that_reads_like_the_option_asks_for_no_document(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = refused(capsys, "--why", "--json")
    assert said.out == ""
    assert "gone.db" in said.err


def test_the_option_itself_asks_for_one_also_behind_such_a_reason(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "gone.db" in json.loads(refused(capsys, "--why", "--json", "--json").out)["refused"]["reason"]


def test_a_misused_command_line_has_its_document_too(capsys):
    assert run_guarded(["report", "--jsno", "--json"]) == 2
    assert "--jsno" in json.loads(capsys.readouterr().out)["refused"]["reason"]


def test_a_refused_calibration_has_its_document_too(capsys, tmp_path):
    assert run_guarded(["calibration", "show", str(tmp_path / "gone.h5"), "--json"]) == 2
    assert "gone.h5" in json.loads(capsys.readouterr().out)["refused"]["reason"]


@pytest.mark.parametrize("reason", ["the database was changed", "run r-1: the database was changed"])
def test_a_broken_run_names_its_run_once(reason):
    assert BrokenRunError("r-1", reason).reason == "run r-1: the database was changed"


def test_what_is_said_of_a_row_is_cut():
    assert RowProblem(3, "short", True).what == "short"
    assert RowProblem(3, "9" * 5000, True).what == "9" * LONGEST_PROBLEM + "… (5000 characters)"
