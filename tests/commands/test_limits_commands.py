"""Limits from a golden lot to a run that is judged by them, as the how-to page says."""

import re
import tomllib

import pytest
from command import QUICK, cbsr_qa, document, short_recipe
from filled_databases import filled
from pages import HOW_TO, blocks, commands, typed
from stored_lots import lot_runs

from cbsr_qa.config.limits import limits_digest
from cbsr_qa.config.loader import load_recipe

pytestmark = pytest.mark.rest

_PAGE = HOW_TO / "propose-limits.md"
_NUMBER = re.compile(r"\d+(?:\.\d+)?")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the lot of the page: thirty sensors, eight of them run twice."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "var").mkdir()
    filled(folder / "var" / "cbsr-qa.db", lot_runs(sensors=30, repeats=8))
    return folder


def _table(text):
    """The table of limits without its head: version and digests are of the identifiers of the runs."""
    return " ".join(text[text.index("Limits\n") :].split())


def test_the_page_runs_as_printed_and_prints_what_it_shows(folder):
    assert len(commands(_PAGE)) == 2
    printed = [typed(folder, command).stdout for command in commands(_PAGE)]
    (shown,) = blocks(_PAGE, "text")
    assert _NUMBER.sub("#", _table(printed[0])).startswith(_NUMBER.sub("#", _table(shown)))
    numbers = zip(_NUMBER.findall(_table(shown)), _NUMBER.findall(_table(printed[0])), strict=False)
    for stated, computed in numbers:
        assert float(stated) == pytest.approx(float(computed), rel=0.02, abs=1e-5), (stated, computed)

    (table,) = blocks(_PAGE, "toml")
    shipped = load_recipe("nine-locations").document.text
    rest = shipped[shipped.index("[[phases]]") : shipped.index("[[limits]]")]
    (folder / "own.toml").write_text(f"{table}\n{rest}")
    recipe = load_recipe(folder / "own.toml").value
    assert recipe.limits_version.version == "golden-1"
    assert [limit.measurement for limit in recipe.limits] == ["centre_of_mass_error", "drift"]


def test_a_run_is_judged_by_a_version_that_its_report_names_before_and_after(tmp_path):
    limit = '[[limits]]\nmeasurement = "drift"\nunit = "%/min"\nlower = -9.0\nupper = 9.0\nversion = "golden-1"\n'
    seal = limits_digest(tomllib.loads(limit)["limits"])
    header = f'[limits_version]\nversion = "golden-1"\ndate = "2026-11-21"\nlimits_sha256 = "{seal}"\n\n'
    (tmp_path / "golden-1.toml").write_text(header + limit)
    recipe = short_recipe(tmp_path, metrics=QUICK, **{"[[phases]]": 'limits_from = "golden-1.toml"\n\n[[phases]]'})
    run = document(cbsr_qa(tmp_path, "run", "--station", "simulated", "--recipe", recipe, "--serial", "A", "--json"))
    (drift,) = (m for m in run["measurements"] if m["name"] == "drift")
    assert (drift["outcome"], drift["upper"], drift["limits_version"]) == ("pass", 9.0, "golden-1")
    assert run["limits_version"] == "golden-1"
    assert {m["limits_version"] for m in run["measurements"] if m["name"] != "drift"} == {None}
    report = tmp_path / run["report"]
    first = report.read_bytes()
    assert b"1 limit of version golden-1, made 2026-11-21." in first
    (tmp_path / "golden-1.toml").unlink()
    report.unlink()
    cbsr_qa(tmp_path, "report", "A")
    assert report.read_bytes() == first
