"""The two sides of a comparison: a commit, checked out and installed once, and a folder where its cases run."""

import json
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from tests.oracle.cases import CASES
from tests.oracle.dumps import dumped
from tests.oracle.masks import UUID, masked

HERE = Path(__file__).resolve().parent
TOP = HERE.parents[1]
SHARED = TOP.parent / "shared" / "data"
#: Seconds that one line may take; a line that takes longer is ended, and its exit code says so.
_LONGEST = 900
#: A JSON document among what was printed: the order of its keys means nothing.
_JSON = re.compile(r"^\{\n.*?^\}$", re.M | re.S)


@dataclass(frozen=True)
class Build:
    """One commit: its checkout and its environment, in a folder that is named by its hash."""

    commit: str
    work: Path

    @classmethod
    def of(cls, revision: str, work: Path) -> "Build":
        hash_ = _git("rev-parse", "--verify", f"{revision}^{{commit}}").decode().strip()[:12]
        return cls(hash_, work)

    @property
    def folder(self) -> Path:
        return self.work / "builds" / self.commit

    @property
    def checkout(self) -> Path:
        return self.folder / "checkout"

    @property
    def venv(self) -> Path:
        return self.folder / "venv"

    def make(self) -> None:
        """Check the commit out and install it, once a folder; the plugin that kills runs is installed beside it."""
        if (self.folder / "built").exists():
            return
        shutil.rmtree(self.folder, ignore_errors=True)
        self.checkout.mkdir(parents=True)
        archive = _git("archive", self.commit)
        subprocess.run(["tar", "-x"], cwd=self.checkout, input=archive, check=True)
        # Built from a copy: setuptools leaves a folder behind where it builds.
        shutil.copytree(HERE / "killer", self.folder / "killer")
        subprocess.run([sys.executable, "-m", "venv", self.venv], check=True)
        pip = [self.venv / "bin" / "python", "-m", "pip", "install", "-q", "--disable-pip-version-check"]
        wanted = ["-c", "constraints.txt", "-e", ".", "setuptools", "wheel"]
        subprocess.run([*pip, *wanted], cwd=self.checkout, check=True, stderr=subprocess.DEVNULL)
        subprocess.run([*pip, "--no-build-isolation", self.folder / "killer"], check=True, stderr=subprocess.DEVNULL)
        (self.venv / ".run-stamp").touch()
        (self.folder / "built").touch()


@dataclass(frozen=True)
class Side:
    """A build, and which time its cases are run: both sides may be of one build."""

    build: Build
    time: int

    @property
    def folder(self) -> Path:
        return self.build.work / "cases" / f"{self.build.commit}-{self.time}"

    def was_run(self, case: str) -> bool:
        """Whether the case was run to its end as it stands today."""
        kept = self._kept(case)
        return kept.exists() and list(json.loads(kept.read_text())) == _names(case)

    def place(self, case: str) -> Path:
        return self.folder / case

    def run(self, case: str) -> None:
        """Run one case; what its lines print is kept beside its folder."""
        place = self.place(case)
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
        self._kept(case).unlink(missing_ok=True)
        printed = {}
        for number, (name, line) in enumerate(zip(_names(case), CASES[case], strict=True), start=1):
            began = time.monotonic()
            printed[name] = self._typed(place, line)
            self._say(f"{case} {number}/{len(CASES[case])} {time.monotonic() - began:.0f} s: {line[:70]}")
        self._kept(case).write_text(json.dumps(printed, indent=1))

    def texts(self, case: str) -> dict[str, str]:
        """Return name → masked text of everything that the case printed and wrote."""
        place = self.place(case)
        folders = {
            str(place): "<folder>",
            str(self.build.checkout): "<checkout>",
            str(self.build.venv): "<venv>",
            str(HERE / "inputs"): "<inputs>",
            str(SHARED): "<shared>",
            os.environ.get("TMPDIR", "/tmp"): "<tmp>",
        }
        printed = json.loads(self._kept(case).read_text())
        texts = {f"{case}/{name}": _JSON.sub(_by_key, text) for name, text in printed.items()}
        for path in sorted(place.rglob("*")):
            text = dumped(path) if path.is_file() else None
            if text is not None:
                texts[f"{case}/{path.relative_to(place)}"] = text
        return by_name(texts, folders)

    def _kept(self, case: str) -> Path:
        return self.folder / f"{case}.printed.json"

    def _say(self, text: str) -> None:
        print(f"  [{self.folder.name}] {text}", file=sys.stderr, flush=True)

    def _typed(self, place: Path, line: str) -> str:
        try:
            line = re.sub(r"\{run:([^}]+)\}", lambda found: _latest_run(place, found[1]), line)
        except sqlite3.Error as error:
            return f"no run to name: {error}\n"
        known = {
            "inputs": HERE / "inputs",
            "shared": SHARED,
            "checkout": self.build.checkout,
            "venv": self.build.venv,
        }
        for name, path in known.items():
            line = line.replace(f"{{{name}}}", str(path))
        with subprocess.Popen(
            ["bash", "-c", line],
            cwd=place,
            env=self._environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="backslashreplace",
            start_new_session=True,
        ) as process:
            try:
                out, err = process.communicate(timeout=_LONGEST)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                out, err = process.communicate()
                err += f"\nended by the oracle after {_LONGEST} s"
        return f"exit {process.returncode}\n{out}\n--- stderr\n{err}"

    def _environment(self) -> dict[str, str]:
        kept = {name: os.environ[name] for name in ("HOME", "TMPDIR") if name in os.environ}
        return {
            **kept,
            "PATH": f"{self.build.venv / 'bin'}:{os.environ['PATH']}",
            "LANG": "C.UTF-8",
            "TZ": "UTC",
            "COLUMNS": "100",
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }


def _names(case: str) -> list[str]:
    return [f"{number:02} {line}" for number, line in enumerate(CASES[case], start=1)]


def _by_key(document: re.Match[str]) -> str:
    try:
        return json.dumps(json.loads(document[0]), indent=2, sort_keys=True, ensure_ascii=False)
    except ValueError:
        return document[0]


def by_name(texts: Mapping[str, str], folders: Mapping[str, str]) -> dict[str, str]:
    """Return masked name → masked text.

    Texts whose names are the same once masked are numbered: by the identities in their names, which are in the order
    of time, and where the names hold digests instead, by what they say.
    """
    named: dict[str, str] = {}
    met: Counter[str] = Counter()
    entries = [(masked(raw, folders), UUID.findall(raw), masked(text, folders)) for raw, text in texts.items()]
    for name, _, text in sorted(entries):
        met[name] += 1
        named[name if met[name] == 1 else f"{name} ({met[name]})"] = text
    return named


def _git(*arguments: str) -> bytes:
    return subprocess.run(["git", *arguments], cwd=TOP, check=True, capture_output=True).stdout


def _latest_run(place: Path, serial: str) -> str:
    with closing(sqlite3.connect(f"file:{place / 'var' / 'cbsr-qa.db'}?mode=ro", uri=True)) as database:
        (run,) = database.execute("select max(run) from runs where serial = ?", (serial,)).fetchone()
        return str(run)
