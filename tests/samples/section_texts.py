"""What a section holds and says, for the tests of sections."""

from dataclasses import replace

from cbsr_qa.domain.results.report import Figure, Table
from cbsr_qa.report.svg import check_svg


def observed(result, **changes):
    """The result with other parts of its observation."""
    return replace(result, observation=replace(result.observation, **changes))


def blocks(section, kind):
    return [block for block in section.blocks if isinstance(block, kind)]


def tables(section):
    return blocks(section, Table)


def texts(table):
    return [[cell.text for cell in row] for row in table.rows]


def check_showable(section):
    """Figures are safe and described; tables have rows as wide as their heads."""
    assert section.blocks
    for figure in blocks(section, Figure):
        check_svg(figure.svg)
        assert figure.caption
        assert figure.alternative
    for table in tables(section):
        assert table.rows
        assert all(len(row) == len(table.columns) for row in table.rows)
        assert max(table.numeric, default=0) < len(table.columns)
