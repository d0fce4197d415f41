"""The figure of presses of real skins is drawn from the table of docs/explanation/place.md."""

import importlib

from pages import HOW_TO

PAGE = HOW_TO.parent / "explanation" / "place.md"


def test_the_figure_is_that_of_the_table(monkeypatch):
    monkeypatch.syspath_prepend(HOW_TO.parent / "figures")
    figure = importlib.import_module("draw_presses")
    assert figure.drawn_from(PAGE.read_text(encoding="utf-8")) == figure.FIGURE.read_text(encoding="utf-8")
