"""Outcomes in a terminal of a hundred columns."""

import pytest

from cbsr_qa.domain.results.report import Banner, Page, Section
from cbsr_qa.report.tables import text_table
from cbsr_qa.report.terminal import terminal_lines

PAGE = Page("", "", Banner("plain", "–", "Answer", ""), (), (), ())
TEXT = "word " * 40


def _lines(columns, row, numeric=()):
    return list(terminal_lines(PAGE, [Section("Section", (text_table("Caption", columns, [row], numeric),))]))


def test_a_wide_table_goes_on_below_its_last_column():
    lines = _lines(("name", "text"), ("a", TEXT))
    assert max(map(len, lines)) <= 100
    rows = lines[lines.index("    name  text") + 1 :]
    assert len(rows) == 3
    assert {row.index("word") for row in rows} == {len("    name  ")}
    assert " ".join(rows).split() == ["a", *TEXT.split()]


@pytest.mark.parametrize(
    ("columns", "row", "numeric"),
    [(("name", "text"), ("a" * 90, TEXT), ()), (("text", "number"), (TEXT, "1"), (1,))],
    ids=["no room", "numbers last"],
)
def test_where_the_last_column_has_no_room_long_texts_take_several_lines(columns, row, numeric):
    lines = _lines(columns, row, numeric)
    assert max(len(line) for line in lines if "a" * 90 not in line) <= 100
    assert " ".join(lines).count("word") == TEXT.count("word")


def test_spaces_that_must_not_break_are_spaces_in_a_terminal():
    assert "    1.00 kΩ" in _lines(("value",), ("1.00\N{NO-BREAK SPACE}kΩ",))
