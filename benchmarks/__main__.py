"""Measure speed and accuracy against the goals and other software.

Prints a table for each part. Without a part, everything is measured and written to docs/reference/performance.md.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
import ast
import platform
import re
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
    "pressed_places",
    "fleet",
    "sync",
)
_HEAD = """# Performance

This page compares the speed and accuracy of the program with its goals and with other software. `make bench` writes
it. Both sides of a comparison run in turn on one machine and one thread, and the fastest repeat of each counts (of
20 or more if one takes less than a tenth of a second). So ratios carry over to other machines, but times do not.
Accuracy is measured against a truth that the method does not know. Unless the table names another, "peer" is pyEIT
1.2.4, run on the same machine.
"""
_COLUMNS = "| what | to reach | here | peer | |\n| --- | --- | --- | --- | --- |\n"


def _arguments() -> list[str]:
    """Return the chosen parts; help lists them with what each measures."""
    listed = "\n".join(f"  {part:<16} {_purpose(part)}" for part in PARTS)
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description=__doc__,
        epilog=f"parts:\n{listed}\n\nother programs:\n{_others()}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("parts", nargs="*", metavar="PART", help="what to measure, by default everything")
    chosen: list[str] = parser.parse_args().parts
    for unknown in sorted(set(chosen) - set(PARTS)):
        parser.error(f"no part is named {unknown!r}; choose from {', '.join(PARTS)}")
    return chosen


def _others() -> str:
    """List the modules that are programs by themselves."""
    files = sorted(Path(__file__).parent.glob("*.py"))
    programs = [
        file.stem for file in files if f"python -m benchmarks.{file.stem}" in file.read_text(encoding="utf-8")
    ]
    return "\n".join(f"  python -m benchmarks.{name}\n      {_purpose(name)}" for name in programs)


def _purpose(module: str) -> str:
    """Return the first line of a module's docstring, without importing it."""
    source = Path(__file__).with_name(f"{module}.py").read_text(encoding="utf-8")
    first = (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0]
    return re.sub(r":mod:|`", "", re.sub(r"; the trials are in .*|: ``python .*", "", first))


def main(chosen: list[str]) -> None:
    """Measure the chosen parts, or everything, which alone is written to the page."""
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


main(_arguments())
