"""An outcome in a terminal: the answer, what it is about, then paragraphs and tables. Figures stay on the page."""

import textwrap
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from typing import Final

from cbsr_qa.domain.results.report import Page, Paragraph, Section, Table
from cbsr_qa.system.words import printable

_WIDTH: Final = 100
#: Longest line of a text in a table that is wider than the terminal.
_CELL: Final = 40
_INDENT: Final = "  "
_MIN_COLUMN_WIDTH: Final = 20  # that a wrapped column has


def terminal_lines(page: Page, sections: Sequence[Section]) -> Iterator[str]:
    """Lay an outcome out in lines of 100 characters.

    A wider table is wrapped in its last column, where that is text and has room for it, else in its longest texts.

    Folded tables, figures and sections for the page alone are left out, and sections of nothing else.
    """
    banner = page.banner
    start = f"{banner.symbol} {banner.headline}"
    yield from _hang_lines("", f"{start}: {banner.reason}" if banner.reason else start)
    facts = [(_name(name), value) for name, value in page.identity]
    facts += [("simulated", text) for text in page.simulated]
    facts += [("warning", text) for text in page.warnings] + [("note", text) for text in page.remarks]
    width = max((len(name) for name, _ in (*facts, *page.printed)), default=0)
    for name, value in facts:
        yield from _hang_lines(f"{name:<{width}}  ", value)
    for name, value in page.printed:
        yield f"{_name(name):<{width}}  {_escape_line(value)}"
    for section in sections:
        lines: list[str] = []
        for block in section.blocks:
            if isinstance(block, Paragraph):
                lines += _hang_lines(_INDENT, f"warning: {block.text}" if block.tone == "warning" else block.text)
            elif isinstance(block, Table) and not block.folded:
                lines += _lay_out_table(block)
        if lines and not section.page_only:
            yield from ("", _escape_line(section.title), *lines)


def _lay_out_table(table: Table) -> Iterator[str]:
    yield from _hang_lines(_INDENT, table.caption)
    rows = [table.columns, *(tuple(_escape_line(cell.text) for cell in row) for row in table.rows)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    room = _WIDTH - 2 * len(_INDENT) - sum(width + 2 for width in widths[:-1])
    if widths[-1] > room >= _MIN_COLUMN_WIDTH and len(widths) - 1 not in table.numeric:
        widths[-1] = room
    elif widths[-1] > room:
        widths = [width if place in table.numeric else min(width, _CELL) for place, width in enumerate(widths)]
    for row in rows:
        wrapped = [
            # Words longer than the column, such as addresses, stay whole.
            textwrap.wrap(cell, width, break_long_words=False, break_on_hyphens=False)
            if len(cell) > width
            else [cell]
            for cell, width in zip(row, widths, strict=True)
        ]
        for parts in zip_longest(*wrapped, fillvalue=""):
            cells = (
                f"{text:>{width}}" if place in table.numeric else f"{text:<{width}}"
                for place, (text, width) in enumerate(zip(parts, widths, strict=True))
            )
            yield f"{_INDENT * 2}{'  '.join(cells)}".rstrip()


def _name(name: str) -> str:
    return name if name.isupper() else name.lower()


def _escape_line(text: str) -> str:
    """Return a text as one line without control characters; non-breaking spaces are wrapped like others."""
    return printable(text.replace("\N{NO-BREAK SPACE}", " "))


def _hang_lines(start: str, text: str) -> Iterator[str]:
    """Wrap text behind its first words, further lines below its beginning."""
    yield from textwrap.wrap(
        _escape_line(text),
        _WIDTH,
        initial_indent=start,
        subsequent_indent=" " * len(start),
        break_long_words=False,
        break_on_hyphens=False,
    )
