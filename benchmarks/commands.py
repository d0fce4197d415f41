"""Whole commands: what a person waits for before anything happens."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks.rows import Row, ratio_row
from benchmarks.timing import compare

TITLE = "Commands"


def rows() -> Iterator[Row]:
    """``--version`` and ``plugins list``, against importing what they avoid."""
    program = str(Path(sys.executable).with_name("cbsr-qa"))
    heavy = [sys.executable, "-c", "import scipy.optimize, sqlalchemy, matplotlib.figure"]
    for arguments in (["--version"], ["plugins", "list"]):
        yield ratio_row(
            compare(
                f"`cbsr-qa {' '.join(arguments)}`",
                ("lazy", lambda arguments=arguments: _quiet([program, *arguments])),
                ("importing what it avoids", lambda: _quiet(heavy)),
                repeats=20,
            )
        )


def _quiet(command: list[str]) -> None:
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
