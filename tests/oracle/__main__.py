"""Builds two commits side by side, runs the same cases with both, and compares all that they print, write and store.

``python -m tests.oracle OLD NEW [--case NAME …] [--work FOLDER]``: exit code 1 where something differs that
``accepted.toml`` does not list with its reason. Recordings are those in ``../shared``; cases that need them are left
out, saying so, where it is absent.
"""

import argparse
import difflib
import os
import re
import sqlite3
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

from tests.oracle.cases import CASES
from tests.oracle.dumps import dumped
from tests.oracle.masks import masked

_HERE = Path(__file__).resolve().parent
_TOP = _HERE.parents[1]
_SHARED = _TOP.parent / "shared" / "data"


@dataclass(frozen=True)
class Side:
    """One commit: its checkout, its environment, and where its cases are run."""

    commit: str
    folder: Path

    @property
    def checkout(self) -> Path:
        return self.folder / "checkout"

    @property
    def venv(self) -> Path:
        return self.folder / "venv"

    def build(self) -> None:
        """Check the commit out and install it, once a folder; the plugin that kills runs is installed beside it."""
        if (self.folder / "built").exists():
            return
        self.checkout.mkdir(parents=True, exist_ok=True)
        archive = subprocess.run(["git", "archive", self.commit], cwd=_TOP, check=True, capture_output=True)
        subprocess.run(["tar", "-x"], cwd=self.checkout, input=archive.stdout, check=True)
        subprocess.run([sys.executable, "-m", "venv", self.venv], check=True)
        pip = [self.venv / "bin" / "python", "-m", "pip", "install", "-q", "--disable-pip-version-check"]
        subprocess.run(
            [*pip, "-c", "constraints.txt", "-e", ".", "setuptools", "wheel"], cwd=self.checkout, check=True
        )
        subprocess.run([*pip, "--no-build-isolation", _HERE / "killer"], check=True)
        (self.venv / ".run-stamp").touch()
        (self.folder / "built").touch()

    def run(self, case: str) -> dict[str, str]:
        """Run one case; returns name → masked text of everything it printed and wrote."""
        place = self.folder / "cases" / case
        subprocess.run(["rm", "-rf", place], check=True)
        place.mkdir(parents=True)
        folders = {
            str(place): "<folder>",
            str(self.checkout): "<checkout>",
            str(self.venv): "<venv>",
            str(_HERE / "inputs"): "<inputs>",
            str(_SHARED): "<shared>",
            os.environ.get("TMPDIR", "/tmp"): "<tmp>",
        }
        texts = {}
        for number, line in enumerate(CASES[case], start=1):
            done = self._typed(place, line)
            texts[f"{case}/{number:02} {line}"] = f"exit {done.returncode}\n{done.stdout}\n--- stderr\n{done.stderr}"
        for path in sorted(place.rglob("*")):
            text = dumped(path) if path.is_file() else None
            if text is not None:
                texts[f"{case}/{path.relative_to(place)}"] = text
        named = [(masked(name, folders), masked(text, folders)) for name, text in texts.items()]
        return dict(sorted(named))

    def _typed(self, place: Path, line: str) -> subprocess.CompletedProcess[str]:
        line = re.sub(r"\{run:([^}]+)\}", lambda found: _latest_run(place, found[1]), line)
        known = {"inputs": _HERE / "inputs", "shared": _SHARED, "checkout": self.checkout, "venv": self.venv}
        for name, path in known.items():
            line = line.replace(f"{{{name}}}", str(path))
        kept = {name: os.environ[name] for name in ("HOME", "TMPDIR") if name in os.environ}
        environment = {
            "PATH": f"{self.venv / 'bin'}:{os.environ['PATH']}",
            "LANG": "C.UTF-8",
            "TZ": "UTC",
            "COLUMNS": "100",
        }
        environment |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        return subprocess.run(
            ["bash", "-c", line], cwd=place, env=kept | environment, capture_output=True, text=True, check=False
        )


def _latest_run(place: Path, serial: str) -> str:
    with closing(sqlite3.connect(place / "var" / "cbsr-qa.db")) as database:
        (run,) = database.execute("select max(run) from runs where serial = ?", (serial,)).fetchone()
        return str(run)


def _differences(old: dict[str, str], new: dict[str, str]) -> Iterator[tuple[str, str]]:
    """Yield (file, changed line)."""
    for name in sorted({*old, *new}):
        before, after = old.get(name, "").splitlines(), new.get(name, "").splitlines()
        for line in difflib.unified_diff(before, after, n=0, lineterm=""):
            if line[0] in "+-" and not line.startswith(("+++", "---")):
                yield name, line


def _accepted() -> list[tuple[str, re.Pattern[str]]]:
    listed = tomllib.loads((_HERE / "accepted.toml").read_text()).get("accepted", [])
    for one in listed:
        assert one["why"], one
    return [(one.get("file", "*"), re.compile(one["line"])) for one in listed]


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.oracle", description=__doc__)
    parser.add_argument("old")
    parser.add_argument("new")
    parser.add_argument("--case", action="append", choices=CASES, help="only this one; may be repeated")
    parser.add_argument("--work", type=Path, help="where to build and run; kept, and built once")
    options = parser.parse_args()
    work = options.work or Path(tempfile.mkdtemp(prefix="oracle-"))
    sides = [
        Side(commit, work.resolve() / f"{number}-{commit}")
        for number, commit in enumerate((options.old, options.new))
    ]
    names = [name for name in options.case or CASES if name != "recordings" or _SHARED.is_dir()]
    if not _SHARED.is_dir():
        print(f"recordings are left out: {_SHARED} is absent")
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(Side.build, sides))
        accepted, left = _accepted(), 0
        for name in names:
            old, new = pool.map(lambda side, name=name: side.run(name), sides)
            found = list(_differences(old, new))
            open_ = [
                (file, line)
                for file, line in found
                if not any(fnmatch(file, glob) and pattern.search(line[1:]) for glob, pattern in accepted)
            ]
            left += len(open_)
            print(
                f"{name}: {len(old)} texts, {len(found) - len(open_)} accepted differences, {len(open_)} others",
                flush=True,
            )
            for file, line in open_[:40]:
                print(f"  {file[:110]}\n    {line[:300]}", flush=True)
    return 1 if left else 0


sys.exit(main())
