"""What the tables of a section say, for the tests of sections."""

from cbsr_qa.domain.results import Table


def tables(section):
    return [block for block in section.blocks if isinstance(block, Table)]


def texts(table):
    return [[cell.text for cell in row] for row in table.rows]
