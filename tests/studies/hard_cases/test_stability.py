"""``stability`` on cases made by hand: how they end, the exit code, the document, the page and the words."""

import json
import math
import re
import warnings
from dataclasses import replace

import pytest

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import ConfigError, NumericsError
from cbsr_qa.studies.hard_cases import stability, stability as catalogue
from cbsr_qa.studies.hard_cases.case import Answer, Ending, HardCase, condition_bound, examine
from cbsr_qa.studies.hard_cases.stability import examine_cases

_KEYS = {"name", "outcome", "error", "bound", "condition", "remedy"}


def _refuse():
    raise NumericsError("the readings say nothing", remedy="mend the contacts <now>")


def _warn():
    warnings.warn("overflow encountered in exp", RuntimeWarning, stacklevel=1)
    return Answer(0.0, 1.0)


def _divide():
    return Answer(1 / 0, 1.0)


def _case(name, run, refuses=None, area="forward model"):
    return HardCase(name, area, "What makes it hard.", "a truth", run, refuses)


_GOOD = (
    _case("within", lambda: Answer(1e-12, condition_bound(1e4), 1e4)),
    _case("exact", lambda: Answer(0.0, 1e-15, None, "mm", "nothing is solved")),
    _case("refused", _refuse, NumericsError, area="readings"),
)
_BROKEN = (
    _case("beyond", lambda: Answer(2e-3, 1e-3, 1.0)),
    _case("no-number", lambda: Answer(math.nan, 1e-3)),
    _case("no-bound", lambda: Answer(1e-3, math.inf)),
    _case("warned", _warn),
    _case("raised", _divide),
    _case("refused-without-need", _refuse),
    _case("refused-otherwise", _refuse, ConfigError),
    _case("not-refused", lambda: Answer(0.0, 1.0), NumericsError),
)


@pytest.fixture
def catalogued(monkeypatch):
    def put(cases):
        monkeypatch.setattr(catalogue, "CASES", cases)
        monkeypatch.setattr(catalogue, "AREAS", tuple(dict.fromkeys(case.area for case in cases)))
        monkeypatch.setattr(stability, "cpu_count", lambda: 1)

    return put


def test_cases_that_end_as_they_should_are_exit_code_0(catalogued, capsys):
    catalogued(_GOOD)
    assert run_guarded(["stability", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert list(document) == ["cases"]
    within, exact, refused = document["cases"]
    assert within.keys() >= _KEYS
    assert (within["outcome"], within["error"], within["condition"]) == ("ok", 1e-12, 1e4)
    assert within["bound"] == pytest.approx(100 * 1e4 * 2.2e-16, rel=0.01)
    assert (exact["unit"], exact["condition"], exact["remedy"]) == ("mm", None, None)
    assert (refused["outcome"], refused["error"], refused["bound"]) == ("refused", None, None)
    assert refused["remedy"] == "mend the contacts <now>"


@pytest.mark.parametrize("case", _BROKEN, ids=lambda case: case.name)
def test_every_other_end_is_broken_and_exit_code_1(catalogued, capsys, case):
    catalogued((*_GOOD, case))
    assert run_guarded(["stability", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)["cases"]
    assert [one["outcome"] for one in found] == ["ok", "ok", "refused", "broken"]
    assert found[-1]["reason"]


def test_a_case_that_hangs_is_broken():
    def hang():
        while True:
            pass

    result = examine(_case("hangs", hang), longest_s=0.1)
    assert (result.outcome, result.reason) == (Ending.BROKEN, "TimeoutError: no end within 0.1 s")
    assert examine(_GOOD[0], longest_s=0.1).outcome is Ending.OK


def test_no_number_is_none_not_nan(catalogued, capsys):
    catalogued((_BROKEN[1], _BROKEN[2]))
    run_guarded(["stability", "--json"])
    first, second = json.loads(capsys.readouterr().out)["cases"]
    assert (first["error"], first["bound"]) == (None, 1e-3)
    assert (second["error"], second["bound"]) == (1e-3, None)


def test_the_terminal_says_how_many_are_broken_and_why(catalogued, capsys):
    catalogued((*_GOOD, *_BROKEN))
    assert run_guarded(["stability"]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "an error of 0.002 where 0.001 is allowed" in said
    assert "ZeroDivisionError" in said
    assert "overflow encountered" in said
    assert "11 cases: 2 within their bound, 1 refused as they should be, 8 broken" in said


def test_areas_and_names_choose_cases(catalogued):
    catalogued(_GOOD)
    assert [r.name for r in examine_cases(areas=["readings"]).cases] == ["refused"]
    assert [r.name for r in examine_cases(areas=["readings"], names=["exact"]).cases] == ["exact", "refused"]
    with pytest.raises(ConfigError, match="no area 'weather'") as refused:
        examine_cases(areas=["weather"])
    assert "forward model, readings" in refused.value.remedy
    with pytest.raises(ConfigError, match="no case 'none'"):
        examine_cases(names=["none"])


def test_a_page_explains_itself_and_draws_every_number(catalogued, tmp_path):
    catalogued((*_GOOD, *_BROKEN))
    page = tmp_path / "page.html"
    assert run_guarded(["stability", "--output", str(page)]) == 1
    text = page.read_text()
    assert text.count("<svg") == 2
    assert "What to do: mend the contacts &lt;now&gt;" in text
    assert "8 cases broken" in text
    for case in (*_GOOD, *_BROKEN):
        assert case.name in text
    assert not re.search(r"\b(nan|inf)\b", text)
    assert "How to read this page" in text


def test_a_page_of_refusals_alone_draws_nothing(catalogued, tmp_path):
    catalogued(_GOOD[2:])
    assert run_guarded(["stability", "--output", str(tmp_path / "page.html")]) == 0
    assert "<svg" not in (tmp_path / "page.html").read_text()


def test_progress_counts_every_case(catalogued):
    catalogued(_GOOD)
    told = []
    examine_cases(progress=lambda done, of: told.append((done, of)))
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]


@pytest.mark.rest
def test_two_processes_find_what_one_finds():
    names = [case.name for case in catalogue.CASES[:2]]
    one, two = (examine_cases(names=names, processes=count) for count in (1, 2))
    assert [replace(case, seconds=0) for case in one.cases] == [replace(case, seconds=0) for case in two.cases]


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ("offset-of-1e6-signal", "did you mean one of: offset-of-1e6-signals"),
        ("qqqq", "cbsr-qa stability --area 'forward model'"),
    ],
)
def test_a_name_that_is_no_case_is_answered_by_those_near_it_and_not_by_all(capsys, asked, told):
    assert run_guarded(["stability", "--only", asked]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert len(said) < 600


def test_a_folder_as_the_page_is_refused_by_its_own_name(catalogued, capsys, tmp_path):
    catalogued(_GOOD)
    assert run_guarded(["stability", "--output", str(tmp_path)]) == 2
    assert f"{tmp_path} cannot be written: it is a folder" in capsys.readouterr().err
