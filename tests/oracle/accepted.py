"""Differences that are meant, from ``accepted.toml``, and what is left without them.

``accepted`` names lines that may differ. ``undone`` is stricter: it says what the old side had where the new one has
something, is put back into the texts before they are compared, and all around it must be the same.
"""

import difflib
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

_KEYS = {"accepted": ("file", "line", "why"), "undone": ("file", "new", "old", "why")}


@dataclass(frozen=True)
class Difference:
    """A line that one side has and the other has not: ``sign`` is ``-`` for the old side's."""

    file: str
    sign: str
    line: str


@dataclass(frozen=True)
class Accepted:
    """Lines that may differ, and why."""

    file: str
    line: re.Pattern[str]
    why: str

    def holds(self, difference: Difference) -> bool:
        return fnmatchcase(difference.file, self.file) and self.line.search(difference.line) is not None


@dataclass(frozen=True)
class Undone:
    """What the new side has, what the old one had in its place, which may be nothing, and why."""

    file: str
    new: re.Pattern[str]
    old: str
    why: str


@dataclass(frozen=True)
class Meant:
    """The list of differences that are meant."""

    accepted: tuple[Accepted, ...] = ()
    undone: tuple[Undone, ...] = ()


class WrongListError(Exception):
    """The list of accepted differences does not say what it must."""


def read_meant(path: Path) -> Meant:
    """Read the tables of a list.

    ``[[accepted]]`` has ``file`` (a glob), ``line`` (a regular expression) and ``why``; ``[[undone]]`` has ``file``,
    ``new`` (a regular expression, in which ``^`` and ``$`` are ends of lines), ``old`` (what is put in its place:
    ``\\1`` is its first group) and ``why``.

    Raises
    ------
    WrongListError : a key is missing, unknown, empty or not text, or a pattern is not a regular expression.
    """
    listed = tomllib.loads(path.read_text())
    if unknown := set(listed) - set(_KEYS):
        raise WrongListError(f"{path}: {min(unknown)!r} is unknown: allowed are {', '.join(map(repr, _KEYS))}")
    accepted = (_texts(path, "accepted", n, one) for n, one in enumerate(listed.get("accepted", []), start=1))
    undone = (_texts(path, "undone", n, one) for n, one in enumerate(listed.get("undone", []), start=1))
    return Meant(
        tuple(Accepted(one["file"], re.compile(one["line"]), one["why"]) for one in accepted),
        tuple(Undone(one["file"], re.compile(one["new"], re.MULTILINE), one["old"], one["why"]) for one in undone),
    )


def _texts(path: Path, kind: str, number: int, one: Mapping[str, object]) -> dict[str, str]:
    where = f"{path}: {kind} {number}"
    if set(one) != set(_KEYS[kind]):
        raise WrongListError(f"{where}: the keys are {sorted(one)}, they must be {sorted(_KEYS[kind])}")
    texts = {key: value for key, value in one.items() if isinstance(value, str) and (value or key == "old")}
    if set(texts) != set(one):
        wrong = min(set(one) - set(texts))
        raise WrongListError(f"{where}: {wrong} must be a text that is not empty, found {one[wrong]!r}")
    pattern = texts["line" if kind == "accepted" else "new"]
    try:
        re.compile(pattern).sub(texts.get("old", ""), "")
    except (re.error, IndexError) as error:
        raise WrongListError(f"{where}: {pattern!r} is no regular expression: {error}") from None
    return texts


def put_back(texts: Mapping[str, str], undone: Sequence[Undone]) -> tuple[dict[str, str], Counter[str]]:
    """Return the texts as the old side has them, and how many places each reason changed."""
    counts: Counter[str] = Counter()
    old = dict(texts)
    for one in undone:
        for name, text in old.items():
            if fnmatchcase(name, one.file):
                old[name], count = one.new.subn(one.old, text)
                counts[one.why] += count
    return old, counts


def differences(old: Mapping[str, str], new: Mapping[str, str]) -> Iterator[Difference]:
    """Yield every line that only one side has, and every text that only one side has, under its name."""
    for name in sorted({*old, *new}):
        if (name in old) != (name in new):
            yield Difference(name, "-" if name in old else "+", "<this whole text>")
        before, after = old.get(name, "").splitlines(), new.get(name, "").splitlines()
        for number, line in enumerate(difflib.unified_diff(before, after, n=0, lineterm="")):
            if number > 1 and line[0] in "+-":  # the first two name the sides
                yield Difference(name, line[0], line[1:])


def judged(found: Sequence[Difference], accepted: Sequence[Accepted]) -> tuple[Counter[str], list[Difference]]:
    """Return how many differences each reason accepts, and those that none does."""
    counts: Counter[str] = Counter()
    left = []
    for difference in found:
        why = next((one.why for one in accepted if one.holds(difference)), None)
        if why is None:
            left.append(difference)
        else:
            counts[why] += 1
    return counts, left
