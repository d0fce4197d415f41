"""History before a run: earlier runs of the sensor, changed configuration files, overridden verdicts."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Any, Final

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity

_ORDINALS: Final = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")
#: Number of latest tries listed one by one.
_TOLD: Final = 5


@dataclass(frozen=True, slots=True)
class EarlierRun:
    """One earlier run.

    Parameters
    ----------
    outcome, reason : outcome and reason of its latest analysis after its last session; None and empty where it has
        none.
    overridden : outcome of an override, and its operator; or None.
    of_check : whether the run belongs to a check of a station.
    changed : description of what is not as it was stored; only name, day and recipe are then known. Empty where
        nothing is.
    chained : whether changed rows of it would be noticed.
    """

    run: str
    started_at: datetime
    sensor: SensorIdentity
    recipe: str
    end: EndReason
    outcome: Outcome | None
    reason: str
    overridden: tuple[Outcome, str] | None = None
    of_check: bool = False
    changed: str = ""
    chained: bool = True

    @property
    def final_outcome(self) -> Outcome | None:
        """The outcome that holds: of the latest override, if there is one."""
        return self.outcome if self.overridden is None else self.overridden[0]

    @property
    def day(self) -> str:
        """Day it began on, UTC."""
        return f"{self.started_at:%Y-%m-%d}"

    @property
    def words(self) -> str:
        return self._ended if self.chained else f"{self._ended} (no chain)"

    @property
    def _ended(self) -> str:
        if self.changed:
            where = self.changed.removeprefix(f"run {self.run}: ").partition(" was ")[0].partition(" cannot ")[0]
            return f"{self.day} changed since it was stored (run {self.run}, {where})"
        if self.end is EndReason.RUNNING:
            return f"{self.day} cut off or still under way"
        if self.end is not EndReason.FINISHED:
            return f"{self.day} {self.end}"
        if self.outcome is None:
            return f"{self.day} no result"
        reason = "" if self.outcome is Outcome.PASS else f" ({self.reason.partition(' (allowed')[0]})"
        decided = "" if self.overridden is None else f", overridden to {self.overridden[0]} by {self.overridden[1]}"
        return f"{self.day} {self.outcome}{reason}{decided}"


@dataclass(frozen=True, slots=True)
class SensorHistory:
    """Runs of a sensor before a given run, with their results in the database.

    Parameters
    ----------
    sensor, recipe : sensor and recipe of the run itself.
    earlier : oldest first.
    """

    sensor: SensorIdentity
    recipe: str
    earlier: tuple[EarlierRun, ...] = ()

    @property
    def tries(self) -> tuple[EarlierRun, ...]:
        """Earlier runs of the same recipe, station checks excluded."""
        return tuple(run for run in self.earlier if run.recipe == self.recipe and not run.of_check)

    @property
    def failed_runs(self) -> tuple[EarlierRun, ...]:
        """Those of them that failed, by the override that holds if there is one."""
        return tuple(run for run in self.tries if run.final_outcome is Outcome.FAIL)

    @property
    def ordinal(self) -> str:
        """Ordinal of this try, as a word up to the tenth."""
        number = len(self.tries) + 1
        if number <= len(_ORDINALS):
            return _ORDINALS[number - 1]
        ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
        return f"{number}{ending}"

    @property
    def words(self) -> str:
        """Ordinal of this try and earlier runs; empty if there are none."""
        checks = [run for run in self.earlier if run.of_check]
        other_runs = [run for run in self.earlier if run.recipe != self.recipe and not run.of_check]
        sentences = []
        if self.tries or other_runs:
            sentences.append(f"{self.ordinal} test with this recipe")
        if self.tries:
            earlier_count = len(self.tries) - _TOLD
            earlier_words = f", and {earlier_count} before" if earlier_count > 0 else ""
            sentences.append(f"earlier: {', '.join(run.words for run in self.tries[-_TOLD:])}{earlier_words}")
        if other_runs:
            sentences.append(
                f"{_runs(other_runs)} of other recipes, the latest ({other_runs[-1].recipe}) {other_runs[-1].words}"
            )
        if checks:
            sentences.append(f"{_runs(checks)} in checks of stations, the latest {checks[-1].words}")
        return "; ".join(sentences)

    @property
    def warnings(self) -> tuple[str, ...]:
        return (*self.differences, *self.changed)

    @property
    def changed(self) -> tuple[str, ...]:
        """Describe earlier runs whose stored rows were changed."""
        return tuple(
            f"an earlier run was changed since it was stored: {run.changed}" for run in self.earlier if run.changed
        )

    @property
    def differences(self) -> tuple[str, ...]:
        """Report earlier runs with another batch or type; an unknown batch differs from none."""
        return tuple(
            f"sensor {self.sensor.serial}: {noun} {current_value!r} now; {', '.join(differing)}:"
            " one is wrong, or two sensors have this serial number"
            for noun, current_value, stated_values in (
                ("batch", self.sensor.batch, [(run.sensor.batch, run) for run in self.earlier]),
                ("type", self.sensor.sensor_type, [(run.sensor.sensor_type, run) for run in self.earlier]),
            )
            if (
                differing := [
                    f"its run of {run.day} says {earlier_value!r}"
                    for earlier_value, run in dict(stated_values).items()
                    if current_value and earlier_value and earlier_value != current_value
                ]
            )
        )


def _runs(some: Iterable[EarlierRun]) -> str:
    count = len(list(some))
    return f"{count} run{'' if count == 1 else 's'}"


#: Text that is stored and shown if no reason was given.
NO_REASON: Final = "no reason given"

#: Fields that tell the tables of a list apart, in the order they are named.
_NAMED_BY: Final = ("measurement", "name", "phase", "qualifier", "sequence")


class FileKind(StrEnum):
    """Kinds of configuration files of a run; the scenes of a station belong to it."""

    RECIPE = "recipe"
    STATION = "station"
    SENSOR_TYPE = "sensor type"
    MATERIAL = "material"


@dataclass(frozen=True, slots=True)
class Difference:
    """One changed key.

    Parameters
    ----------
    key : key as in the file, tables of a list by their names: ``"limits[drift].upper"``.
    before, after : values as JSON; None where the key was not there.
    """

    key: str
    before: str | None
    after: str | None

    @property
    def words(self) -> str:
        if self.before is None:
            return f"{self.key} = {self.after} added"
        return (
            f"{self.key} = {self.before} removed"
            if self.after is None
            else f"{self.key} {self.before} → {self.after}"
        )


@dataclass(frozen=True, slots=True)
class ConfigurationChange:
    """A run used a file of a known name with different content than the latest run before it.

    Parameters
    ----------
    run, earlier_run : run that used the new content, and the latest one that used the old.
    old_digest, new_digest : SHA-256 of the contents.
    differences : key by key, limits first.
    by, at : operator of the run, and when it began.
    why : reason in the operator's words, or :data:`NO_REASON`.
    """

    run: str
    kind: FileKind
    name: str
    earlier_run: str
    old_digest: str
    new_digest: str
    differences: tuple[Difference, ...]
    by: str
    at: datetime
    why: str

    def words(self, most: int = 3) -> str:
        """Describe the changes, with at most this many differences."""
        listed = "; ".join(difference.words for difference in self.differences[:most])
        more = len(self.differences) - most
        return f"{listed}; and {more} more" if more > 0 else listed


@dataclass(frozen=True, slots=True)
class ChangeHistory:
    """Changes of one run's files since its sensor type last passed its recipe.

    Parameters
    ----------
    accepted_run : the latest earlier run of the sensor type with the recipe that passed; empty without one, and
        ``changes`` are then all there are.
    changes : oldest first; those of the run itself among them.
    altered : problems of runs whose changes are left out, because they do not match their chains.
    """

    accepted_run: str = ""
    changes: tuple[ConfigurationChange, ...] = ()
    altered: tuple[str, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(
            f"changes of files noted with an earlier run are not shown: {problem}" for problem in self.altered
        )

    def changes_in(self, run: str) -> tuple[ConfigurationChange, ...]:
        return tuple(change for change in self.changes if change.run == run)


@dataclass(frozen=True, slots=True)
class VerdictOverride:
    """An operator's decision that overrides a verdict, stored beside it.

    Parameters
    ----------
    analysis, verdict : analysis whose verdict it overrides, and that verdict.
    outcome : passed or failed.
    by, at, why : person who decided, time and reason.
    """

    override: str
    run: str
    analysis: str
    verdict: Outcome
    outcome: Outcome
    by: str
    at: datetime
    why: str

    @property
    def words(self) -> str:
        decided = f"{self.verdict.value} overridden to {self.outcome.value} by {self.by}"
        return f"{decided} on {self.at.astimezone():%Y-%m-%d %H:%M %Z}: {self.why}"


def differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[Difference, ...]:
    """Compare two versions of a file key by key, limits first, then in file order.

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
    elif isinstance(content, list) and content and all(isinstance(table, Mapping) for table in content):
        for label, table in zip(_labels(content), content, strict=True):
            yield from _leaves(f"{at}[{label}]", table)
    else:
        yield at, json.dumps(content, ensure_ascii=False, sort_keys=True)


def _labels(tables: Sequence[Mapping[str, Any]]) -> list[str]:
    """Name each table of a list by its key, and by its number if two share it."""
    labels: list[str] = []
    for number, table in enumerate(tables, start=1):
        label = ", ".join(str(table[key]) for key in _NAMED_BY if table.get(key)) or str(number)
        labels.append(f"{label}, {number}" if label in labels else label)
    return labels
