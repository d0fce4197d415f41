"""The figure of minutes a sensor is drawn from the first table of docs/explanation/what-accuracy-costs.md."""

import importlib

from pages import HOW_TO

PAGE = HOW_TO.parent / "explanation" / "what-accuracy-costs.md"


def test_the_figure_is_that_of_the_table(monkeypatch):
    monkeypatch.syspath_prepend(HOW_TO.parent / "figures")
    figure = importlib.import_module("draw_minutes")
    page = PAGE.read_text(encoding="utf-8")
    assert [name.split(",")[0] for name, *_ in figure.read_rows(page)] == [
        "the paper's campaign",
        "sixteen fixed places",
        "adaptive",
        *["adaptive-batch"] * 2,
    ]
    assert figure.draw_page(page) == figure.FIGURE.read_text(encoding="utf-8")
