"""The page on force: its figures are those its script draws, and what it calls by name is there."""

import importlib
import re
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from cbsr_qa.report.svg import check_svg
from cbsr_qa_plugins.metrics.force import ForceError

TOP = Path(__file__).parents[3]
PAGE = TOP / "docs" / "explanation" / "force.md"
FOLDER = PAGE.parent / "figures" / "force"


@pytest.fixture
def drawing(monkeypatch):
    monkeypatch.syspath_prepend(TOP / "docs" / "figures")
    module = importlib.import_module("draw_force")
    yield module
    for name in [name for name in sys.modules if name.split(".")[0] in ("draw_force", "simulation_figures")]:
        del sys.modules[name]


def test_every_figure_is_shown_and_can_do_nothing_but_be_looked_at(drawing):
    shown = re.findall(r"!\[[^\]]{20,}\]\(figures/force/(\w+)\.svg\)", PAGE.read_text(encoding="utf-8"))
    assert sorted(shown) == sorted(drawing.FIGURES) == sorted(path.stem for path in FOLDER.iterdir())
    for path in FOLDER.iterdir():
        check_svg(path.read_text(encoding="utf-8"))


def test_a_figure_is_what_the_script_draws_today(drawing):
    pinned = re.search(r"^matplotlib==(.+)$", (TOP / "constraints.txt").read_text(), re.M)[1]
    if version("matplotlib") != pinned:
        pytest.skip(f"the figures were drawn with matplotlib {pinned}, here is {version('matplotlib')}")
    from simulation_figures.look import as_file

    assert as_file("section", drawing.FIGURES["section"]) == (FOLDER / "section.svg").read_text(encoding="utf-8")


def test_the_drawn_bands_hold_the_truth_as_often_as_they_say(drawing):
    places = np.random.default_rng(2).uniform(-28, 28, (300, 2))
    mean, variance = drawing.learned(39).predict(places)
    off = (np.log(drawing.response_under_head(places)) - mean) / np.sqrt(variance)
    assert 0.85 < (np.abs(off) < 2).mean() <= 1  # places of one sheet are far from independent


def test_every_measurement_of_the_metric_is_explained():
    text = (PAGE.parent / "metrics.md").read_text(encoding="utf-8")
    assert not [name for name in ForceError.measures if f"`{name}`" not in text]
