"""Prints the table and writes it to ``docs/reference/performance.md``."""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

from pathlib import Path

from benchmarks import commands, forward, metrics
from benchmarks.timing import Compared

_PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "performance.md"
_HEAD = """# Performance

Written by `make bench`: both ways of each row are timed in turn on one machine, and the fastest of each is kept. The
ratio carries over to other machines; the times do not.

| what | here | instead | ratio |
| --- | --- | --- | --- |
"""


def main() -> None:
    """Measure everything."""
    rows: list[Compared] = []
    for suite in (commands, forward, metrics):
        for compared in suite.compared():
            print(compared.row(), flush=True)
            rows.append(compared)
    _PAGE.write_text(_HEAD + "\n".join(row.row() for row in rows) + "\n")
    print(f"written to {_PAGE}")


main()
