"""The page on the simulated world says of every effect what it models, what not and from where, and draws it."""

import importlib
import re
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import pytest

from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.report.svg import check_svg
from cbsr_qa.simulate.chain import STAGES
from cbsr_qa_plugins.registry import BUILT_IN

TOP = Path(__file__).parents[2]
PAGE = TOP / "docs" / "explanation" / "simulation.md"
FOLDER = PAGE.parent / "figures"
TEXT = PAGE.read_text(encoding="utf-8")
EFFECTS = [name for kind, name, _ in BUILT_IN if kind is Kind.EFFECT]

#: Drawn from the effect alone, without a sheet to solve.
CHEAP = ("quantisation", "confinement", "head-edge", "pressure-profile")


def sections():
    """Text of each effect's section, and the stage above it."""
    found = {}
    for stage, below in re.findall(r"^## Stage `(\w+)`.*?$(.*?)(?=^## |\Z)", TEXT, re.M | re.S):
        for name, section in re.findall(r"^### (\S+)$(.*?)(?=^### |\Z)", below, re.M | re.S):
            assert name not in found, f"{name} has two sections"
            found[name] = (stage, section)
    return found


SECTIONS = sections()


@pytest.fixture(scope="module")
def plugins():
    return discover()


@pytest.fixture
def drawing(monkeypatch):
    """The drawing script, as a module."""
    monkeypatch.syspath_prepend(TOP / "docs" / "figures")
    module = importlib.import_module("draw_simulation")
    yield module
    for name in [name for name in sys.modules if name.split(".")[0] in ("draw_simulation", "simulation_figures")]:
        del sys.modules[name]


def test_every_effect_has_a_section_and_every_section_an_effect():
    assert sorted(SECTIONS) == sorted(EFFECTS)
    assert not re.search(r"^### ", re.sub(r"^## Stage .*?(?=^## (?!Stage))", "", TEXT, flags=re.M | re.S), re.M)


def test_all_stages_are_there_in_their_order():
    assert tuple(re.findall(r"^## Stage `(\w+)`", TEXT, re.M)) == STAGES
    assert tuple(re.findall(r"^\| (\w+) \|.*\|.*\|$", TEXT.split("\n## ")[1], re.M))[1:] == STAGES


@pytest.mark.parametrize("name", EFFECTS)
def test_a_section_says_what_is_modelled_what_not_and_from_where(name, plugins):
    stage, section = SECTIONS[name]
    effect = plugins.factory(Kind.EFFECT, name)
    assert stage == effect.perturbs
    modelled, not_modelled, source, figure = section.strip().split("\n\n")
    assert not_modelled.startswith("**Not modelled:** ")
    assert source.startswith("**Source:** ")
    assert figure.startswith("![")
    said = set(re.findall(r"`([^`]+)`", modelled))
    options = set(effect.Options.model_fields)
    assert options <= said, "options without a word"
    assert set(effect.needs) <= said, "what it needs is not said"


@pytest.mark.parametrize("name", EFFECTS)
def test_a_section_shows_its_figure_in_words_too(name):
    ((words, target),) = re.findall(r"!\[([^]]*)\]\(([^)]+)\)", SECTIONS[name][1])
    assert target == f"figures/{name}.svg"
    assert len(words.split()) > 15


@pytest.mark.parametrize("name", EFFECTS)
def test_a_figure_is_a_small_drawing_with_nothing_in_it_but_what_is_seen(name):
    svg = (FOLDER / f"{name}.svg").read_text(encoding="utf-8")
    assert len(svg.encode()) < 40 * 1024
    assert not re.search(r"<(\w+:)?(date|metadata)|20\d\d-\d\d-\d\d", svg)
    root = ElementTree.fromstring(check_svg(svg))
    said = ["".join(text.itertext()) for text in root.iter("{http://www.w3.org/2000/svg}text")]
    assert len(said) > 5, "text is drawn as outlines"
    assert root.get("width") == "640"


def test_the_script_draws_what_is_shown_and_nothing_else(drawing):
    assert sorted(drawing.FIGURES) == sorted(EFFECTS)
    assert {path.name for path in FOLDER.iterdir()} >= {f"{name}.svg" for name in drawing.FIGURES}
    assert all(path.stem in drawing.FIGURES for path in FOLDER.glob("*.svg"))


def test_the_script_says_which_figures_there_are(drawing, capsys):
    assert drawing.main(["no-such-effect"]) == 2
    assert "no figure of no-such-effect; there are uneven-conductance" in capsys.readouterr().err


@pytest.mark.parametrize("name", CHEAP)
def test_a_figure_is_what_the_script_draws_today(name, drawing):
    pinned = re.search(r"^matplotlib==(.+)$", (TOP / "constraints.txt").read_text(), re.M)[1]
    if version("matplotlib") != pinned:
        pytest.skip(f"the figures were drawn with matplotlib {pinned}, here is {version('matplotlib')}")
    from simulation_figures.look import as_file

    assert as_file(name, drawing.FIGURES[name]) == (FOLDER / f"{name}.svg").read_text(encoding="utf-8")


def test_links_within_the_page_lead_to_headings():
    headings = re.findall(r"^#+ (.+)$", TEXT, re.M)
    anchors = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
    links = set(re.findall(r"\]\(#([^)]+)\)", TEXT))
    assert set(EFFECTS) | links <= anchors


def test_figures_and_their_script_stay_out_of_the_wheel():
    folders = tomllib.loads((TOP / "pyproject.toml").read_text())["tool"]["setuptools"]["package-dir"].values()
    assert "docs" not in {Path(folder).parts[0] for folder in folders}
