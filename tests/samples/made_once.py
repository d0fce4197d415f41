"""What takes seconds to make is made once on disk, by whichever worker needs it first, and copied by every other."""

import fcntl
import hashlib
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

_shared: list[Path] = []


def share(folder: Path) -> None:
    """Say where workers of one test run keep what they share (``tests/conftest.py`` does)."""
    _shared[:] = [folder]


def made_once(name: str, make: Callable[[Path], object]) -> Path:
    """Return a folder that ``make`` filled; nobody may write into it.

    Workers that need it meanwhile wait. Where making fails, the next who needs it tries again.
    """
    (kept,) = _shared
    kept.mkdir(parents=True, exist_ok=True)
    folder, done = kept / name, kept / f"{name}.done"
    with (kept / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            done.touch()
    return folder


def copy_of(name: str, make: Callable[[Path], object], folder: Path) -> Path:
    """Copy what is :func:`made_once` into a folder of one's own, which may be there; returns it."""
    shutil.copytree(made_once(name, make), folder, dirs_exist_ok=True)
    return folder


def named_by(kind: str, *content: object) -> str:
    """Return a name that is the same where the content is: numbers, texts, and lists and dataclasses of them."""
    said = repr(content)
    assert " at 0x" not in said, f"{said}: tells no content"
    return f"{kind}-{hashlib.sha256(said.encode()).hexdigest()[:16]}"


def value_made_once(name, make):
    """Return a value that was made once, read from disk: everyone has one of one's own."""
    folder = made_once(name, lambda folder: (folder / "value.pickle").write_bytes(pickle.dumps(make())))
    return pickle.loads((folder / "value.pickle").read_bytes())
