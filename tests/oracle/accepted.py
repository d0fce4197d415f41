"""Differences that are meant, from ``accepted.toml``, and what is left without them."""

import difflib
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

_KEYS = {"file", "line", "why"}


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


class WrongListError(Exception):
    """The list of accepted differences does not say what it must."""


def read_accepted(path: Path) -> tuple[Accepted, ...]:
    """Read ``[[accepted]]`` tables of ``file`` (a glob), ``line`` (a regular expression) and ``why``.

    Raises
    ------
    WrongListError : keys that are missing, unknown, empty or no text, or a pattern that is none.
    """
    listed = tomllib.loads(path.read_text())
    if unknown := set(listed) - {"accepted"}:
        raise WrongListError(f"{path}: {min(unknown)!r} is unknown: allowed is 'accepted'")
    return tuple(_entry(f"{path}: accepted {n}", one) for n, one in enumerate(listed.get("accepted", []), start=1))


def _entry(where: str, one: Mapping[str, object]) -> Accepted:
    if set(one) != _KEYS:
        raise WrongListError(f"{where}: the keys are {sorted(one)}, they must be {sorted(_KEYS)}")
    file, line, why = one["file"], one["line"], one["why"]
    if not (isinstance(file, str) and isinstance(line, str) and isinstance(why, str) and file and line and why):
        raise WrongListError(f"{where}: file, line and why must be texts that are not empty")
    try:
        return Accepted(file, re.compile(line), why)
    except re.error as error:
        raise WrongListError(f"{where}: {line!r} is no regular expression: {error}") from None


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
