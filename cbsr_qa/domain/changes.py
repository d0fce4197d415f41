"""What was changed by somebody: files of a name that a run used with another content, and verdicts."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Any, Final

from cbsr_qa.domain.outcome import Outcome

#: What is stored and said where nobody said why.
NO_REASON: Final = "no reason given"

#: Fields that tell the tables of a list apart, in the order they are named.
_NAMED_BY: Final = ("measurement", "name", "phase", "qualifier", "sequence")


class FileKind(StrEnum):
    """Files a run is configured by; the scenes of a station belong to it."""

    RECIPE = "recipe"
    STATION = "station"
    SENSOR_TYPE = "sensor type"
    MATERIAL = "material"


@dataclass(frozen=True, slots=True)
class Difference:
    """One key whose value changed.

    Parameters
    ----------
    key : as in the file, tables of a list by their names: ``"limits[drift].upper"``.
    before, after : as JSON; None where the key was not there.
    """

    key: str
    before: str | None
    after: str | None

    @property
    def words(self) -> str:
        """The same for people."""
        if self.before is None:
            return f"{self.key} = {self.after} added"
        return (
            f"{self.key} = {self.before} removed"
            if self.after is None
            else f"{self.key} {self.before} → {self.after}"
        )


@dataclass(frozen=True, slots=True)
class ConfigurationChange:
    """A run used a file of a known name with another content than the latest run before it.

    Parameters
    ----------
    run, earlier_run : that used the new content, and the latest one that used the old.
    old_digest, new_digest : SHA-256 of the contents.
    differences : key by key, limits first.
    operator, noted_at : of the run.
    why : in the operator's words; :data:`NO_REASON` where there were none.
    """

    run: str
    kind: FileKind
    name: str
    earlier_run: str
    old_digest: str
    new_digest: str
    differences: tuple[Difference, ...]
    operator: str
    noted_at: datetime
    why: str

    def words(self, most: int = 3) -> str:
        """Say what changed, with so many differences at most."""
        shown = "; ".join(one.words for one in self.differences[:most])
        more = len(self.differences) - most
        return f"{shown}; and {more} more" if more > 0 else shown


@dataclass(frozen=True, slots=True)
class ChangeHistory:
    """Changes of the files of one run, since its sensor type last passed its recipe.

    Parameters
    ----------
    accepted_run : the latest earlier run of the sensor type with the recipe that passed; empty where there is none,
        and ``changes`` are then all there are.
    changes : oldest first; those of the run itself among them.
    """

    accepted_run: str = ""
    changes: tuple[ConfigurationChange, ...] = ()

    def of(self, run: str) -> tuple[ConfigurationChange, ...]:
        """Return the changes that one run brought."""
        return tuple(change for change in self.changes if change.run == run)


@dataclass(frozen=True, slots=True)
class VerdictOverride:
    """Somebody's decision against a verdict, beside it.

    Parameters
    ----------
    analysis, verdict : whose verdict it overrides, and what that was.
    outcome : passed or failed.
    operator, why, noted_at : who decided, for what reason, and when.
    """

    override: str
    run: str
    analysis: str
    verdict: Outcome
    outcome: Outcome
    operator: str
    why: str
    noted_at: datetime

    @property
    def words(self) -> str:
        """The same for people."""
        return (
            f"{self.verdict.value} overridden to {self.outcome.value} by {self.operator}"
            f" on {self.noted_at:%Y-%m-%d %H:%M} UTC: {self.why}"
        )

    def document(self) -> dict[str, Any]:
        """Return the same as a JSON object."""
        return {
            "override": self.override,
            "run": self.run,
            "analysis": self.analysis,
            "verdict": str(self.verdict),
            "outcome": str(self.outcome),
            "by": self.operator,
            "at": self.noted_at.isoformat(),
            "why": self.why,
        }


def differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[Difference, ...]:
    """Compare two contents of a file key by key, limits first, then in the order of the keys.

    Parameters
    ----------
    before, after : tables, lists and values as JSON knows them.
    """
    old, new = dict(_leaves("", before)), dict(_leaves("", after))
    changed = [key for key in dict.fromkeys([*old, *new]) if old.get(key) != new.get(key)]
    changed.sort(key=lambda key: (not key.startswith("limits"), key))
    return tuple(Difference(key, old.get(key), new.get(key)) for key in changed)


def _leaves(at: str, content: Any) -> Iterator[tuple[str, str]]:
    """Yield (path, JSON) of everything that is neither a table nor a list of tables; empty ones count as such."""
    if isinstance(content, Mapping) and content:
        for key, value in content.items():
            yield from _leaves(f"{at}.{key}" if at else str(key), value)
    elif isinstance(content, list) and content and all(isinstance(one, Mapping) for one in content):
        for label, one in zip(_labels(content), content, strict=True):
            yield from _leaves(f"{at}[{label}]", one)
    else:
        yield at, json.dumps(content, ensure_ascii=False, sort_keys=True)


def _labels(tables: Sequence[Mapping[str, Any]]) -> list[str]:
    """Name each table of a list: by what it is of, and by its number where two are of the same."""
    found: list[str] = []
    for number, table in enumerate(tables, start=1):
        named = ", ".join(str(table[key]) for key in _NAMED_BY if table.get(key)) or str(number)
        found.append(f"{named}, {number}" if named in found else named)
    return found
