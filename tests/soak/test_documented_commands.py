"""What the documentation tells a user to type and ``make test-all`` shortens, in full; and its figures."""

import importlib
import json
import os
import re
import subprocess
import sys
from importlib.metadata import version

import pytest
from pages import (
    SHORTENED,
    TOP,
    TYPED,
    assert_printed,
    assert_same_figures,
    assert_same_tables,
    blocks,
    in_full,
    same_words,
    typed,
)

LIMIT_S = 4 * 3600
PAPER = TOP / "docs" / "explanation" / "paper.md"
FIGURES = TOP / "docs" / "explanation" / "figures"


@pytest.mark.parametrize("page", [page for page in (*TYPED, *SHORTENED) if in_full(page)])
def test_a_page_runs_in_full(tmp_path, page):
    for line in in_full(page):
        if line.startswith("python "):
            subprocess.run([sys.executable, *line.split()[1:]], cwd=tmp_path, env=_environment("var"), check=True)
            continue
        printed = typed(tmp_path, line, limit_s=LIMIT_S).stdout
        assert printed.strip(), line
        if line.startswith("cbsr-qa reproduce paper") and "--quick" not in line:
            for shown in blocks(PAPER, "text"):
                assert_printed(shown, printed)


@pytest.mark.parametrize("target", ["demo", "fleet-demo"])
def test_what_the_readme_has_a_stranger_make_is_made(tmp_path, target):
    assert f"make {target}`" in (TOP / "README.md").read_text() + (TOP / "docs/how-to/compare-batches.md").read_text()
    subprocess.run(["make", target], cwd=TOP, env=_environment(str(tmp_path)), check=True, timeout=LIMIT_S)
    assert any(tmp_path.iterdir())


def _environment(var):
    """Without a screen, so that no browser opens."""
    screens = ("DISPLAY", "WAYLAND_DISPLAY")
    return {**{name: value for name, value in os.environ.items() if name not in screens}, "CBSR_QA_VAR": var}


@pytest.mark.parametrize(("script", "folder"), [("draw_simulation", FIGURES), ("draw_force", FIGURES / "force")])
def test_every_figure_is_what_its_script_draws_today(monkeypatch, script, folder):
    pinned = re.search(r"^matplotlib==(.+)$", (TOP / "constraints.txt").read_text(), re.M)[1]
    if version("matplotlib") != pinned:
        pytest.skip(f"the figures were drawn with matplotlib {pinned}, here is {version('matplotlib')}")
    monkeypatch.syspath_prepend(TOP / "docs" / "figures")
    figures = importlib.import_module(script).FIGURES
    as_file = importlib.import_module("simulation_figures.look").as_file
    stale = [name for name, draw in figures.items() if as_file(name, draw) != (folder / f"{name}.svg").read_text()]
    assert not stale


def test_the_tables_of_what_accuracy_costs_are_those_of_today(tmp_path, monkeypatch):
    points = json.loads(typed(tmp_path, "cbsr-qa frontier --json", limit_s=LIMIT_S).stdout)["points"]
    monkeypatch.syspath_prepend(TOP / "docs" / "figures")
    tables = importlib.import_module("write_frontier_tables")
    page = tables.PAGE.read_text()
    assert_same_tables(page, tables.written(page, [tables.restore(tables.Point, one) for one in points]))


def test_the_trials_of_compensation_are_those_of_today():
    printed = _benchmark("benchmarks", "steady_state")
    section = (TOP / "docs/reference/performance.md").read_text().partition("## Transient compensation")[2]
    stated, found = ([line for line in text.splitlines() if "frames/s:" in line] for text in (section, printed))
    assert len(stated) == len(found) > 20
    for one, other in zip(stated, found, strict=True):
        assert_same_figures(one, other, one.partition("|")[2][:60])


def test_the_strips_of_the_page_on_characterisation_are_those_of_today():
    page = " ".join((TOP / "docs/explanation/characterisation.md").read_text().split())
    printed = re.findall(r"60 cycles, (.+?): (\S+ ± \S+(?: kPa| s)?),", _benchmark("benchmarks.characterisation"))
    assert len(printed) == 8
    for quantity, figure in printed:
        (row,) = re.findall(rf"\| {quantity} \|[^|]+\|[^|]+\|", page)
        assert f" {figure}, true" in row, quantity


@pytest.mark.parametrize(
    ("page", "words"),
    [
        (
            "metrics",
            ["benchmarks.sheet_metrics", "weighting", "settling", "agreement", "against_strip", "hysteresis"],
        ),
        ("force", ["benchmarks.several_heads"]),
        ("force", ["benchmarks.streams"]),
        ("force", ["benchmarks.force_coverage", "--sensors", "9wt", "--to", "9wt.json"]),
    ],
    ids=lambda given: given if isinstance(given, str) else given[0],
)
def test_the_tables_of_a_page_are_what_its_benchmark_prints(tmp_path, page, words):
    words = [str(tmp_path / word) if word.endswith(".json") else word for word in words]
    stated = (TOP / "docs" / "explanation" / f"{page}.md").read_text(encoding="utf-8").splitlines()
    printed = [line for line in _benchmark(*words).splitlines() if line.startswith("| ") and "---" not in line]
    assert len(printed) > 2
    for line in printed:
        rows = [row for row in stated if row.split("|")[1:2] == line.split("|")[1:2] and same_words(row, line)]
        assert rows, line  # of tables with equal heads the first; all other rows differ in words or name
        assert_same_figures(rows[0], line, line)


def _benchmark(*words):
    """What a benchmark prints, typed in the checkout."""
    command = [sys.executable, "-m", *words]
    run = subprocess.run(command, cwd=TOP, env=_environment("var"), check=True, capture_output=True, text=True)
    return run.stdout
