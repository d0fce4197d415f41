"""Pages of results among the rules that JupyterLab has for tables: text differs from what is behind it."""

import pytest

from cbsr_qa.domain.results.report import Banner, Page, Paragraph, Section
from cbsr_qa.report.render import render_fragment
from cbsr_qa.report.tables import text_table

#: As in JupyterLab's dark theme, where rows are striped and text is light.
_DARK = """
body { background: #111; }
.jp-RenderedHTMLCommon, .jp-RenderedHTMLCommon table, .jp-RenderedHTMLCommon h2 { color: rgb(222, 222, 222); }
.jp-RenderedHTMLCommon tbody tr:nth-child(odd) { background: rgb(17, 17, 17); }
.jp-RenderedHTMLCommon tbody tr:nth-child(even) { background: rgb(33, 33, 33); }
"""
_COLOURS = """elements => elements.map(element => [getComputedStyle(element).color,
    getComputedStyle(element.closest("tr") || element).backgroundColor])"""


@pytest.mark.rest
def test_tables_are_dark_on_white_in_a_dark_notebook(chromium):
    table = text_table("", ("event", "x [mm]"), [("E1", "1.0"), ("E2", "2.0")])
    section = Section("Events", (Paragraph("Two."), table))
    fragment = render_fragment(Page("Analysis", "scene", Banner("plain", "●", "2 events", ""), ()), [section])
    page = chromium.new_page()
    page.set_content(f'<!doctype html><style>{_DARK}</style><div class="jp-RenderedHTMLCommon">{fragment}</div>')
    colours = page.eval_on_selector_all("h2, th, td", _COLOURS)
    assert len(colours) == 7
    for ink, behind in colours:
        assert max(map(int, ink.removeprefix("rgb(").rstrip(")").split(","))) < 100
        assert behind == "rgba(0, 0, 0, 0)"
    page.close()
