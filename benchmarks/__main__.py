"""Prints the table and writes it to ``docs/reference/performance.md``. Names of parts choose some of them."""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import platform
import sys
from importlib import import_module
from pathlib import Path

from benchmarks.rows import Row

_PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "performance.md"
PARTS = (
    "commands",
    "bench",
    "forward",
    "outlines",
    "simulated_world",
    "reconstruction",
    "metrics",
    "localisation",
    "load_estimate",
    "methods",
    "steady_state",
    "force",
    "fleet",
)
_HEAD = """# Performance

This page compares the speed and accuracy of the program with its goals and with other software. `make bench` writes
it. Both sides of a comparison run in turn on one machine and one thread, and the fastest repeat of each counts (of
20 or more if one takes less than a tenth of a second). So ratios carry over to other machines, but times do not.
Accuracy is measured against a truth that the method does not know. Unless the table names another, "peer" is pyEIT
1.2.4, run on the same machine.
"""
_COLUMNS = "| what | to reach | here | peer | |\n| --- | --- | --- | --- | --- |\n"


def main(chosen: list[str]) -> None:
    """Measure the chosen parts, or everything, which alone is written to the page."""
    unknown = sorted(set(chosen) - set(PARTS))
    if unknown:
        sys.exit(f"no part of the benchmarks is called {unknown[0]!r}; there are {', '.join(PARTS)}")
    page = [_HEAD, f"\nMeasured on {platform.machine()}, Python {platform.python_version()}.\n"]
    missed: list[Row] = []
    for part in chosen or PARTS:
        print(f"== {part}", flush=True)
        suite = import_module(f"benchmarks.{part}")
        page.append(f"\n## {suite.TITLE}\n\n{_COLUMNS}")
        for row in suite.rows():
            print(row.markdown(), flush=True)
            page.append(row.markdown() + "\n")
            missed += [row] if row.met is False else []
        page.append(getattr(suite, "notes", str)())
    for row in missed:
        print(f"not reached: {row.what} ({row.goal}): {row.here}")
    if not chosen:
        _PAGE.write_text("".join(page))
        print(f"written to {_PAGE}")


main(sys.argv[1:])
