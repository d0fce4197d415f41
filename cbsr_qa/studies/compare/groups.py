"""Groups of runs, the deciding run of each sensor, and which differences the runs can estimate."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import RunLine
from cbsr_qa.report.tables import list_names
from cbsr_qa.stats.crossings import Crossing, IntArray, crossing
from cbsr_qa.studies.compare.terms import By, Period, Policy, Terms
from cbsr_qa.studies.compare.values import BoolArray
from cbsr_qa.studies.selection import nearest, software_words
from cbsr_qa.system.words import echo

PASSED: Final = (Outcome.PASS, Outcome.MARGINAL)
#: Batch name of runs without a batch.
NO_BATCH: Final = "batch not stated"
#: Groupings independent of batches that may still coincide with them.
_GROUPS: Final = {By.PERIOD: "period", By.SOFTWARE: "software version"}


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """Runs sorted into groups.

    Parameters
    ----------
    names : names of the groups, the reference first.
    labels, used : (R,) group of each run (empty if left out), and whether it counts.
    tests : group → sensor → indices of its runs that count, in order of time.
    left_out : reason → number of runs that do not count.
    """

    names: tuple[str, ...]
    labels: tuple[str, ...]
    used: BoolArray
    tests: Mapping[str, Mapping[str, tuple[int, ...]]]
    left_out: Mapping[str, int]

    @property
    def reference(self) -> str:
        """The group the others are compared with."""
        return self.names[0]

    def deciding(self, runs: Sequence[RunLine], policy: Policy) -> dict[str, IntArray]:
        """Return the deciding run of each sensor, by group."""
        return {
            name: np.array([decides(runs, tests, policy) for tests in self.tests[name].values()], dtype=np.intp)
            for name in self.names
        }


def group_runs(runs: Sequence[RunLine], terms: Terms) -> Grouping:
    """Sort runs into groups.

    RefusedError if no run was finished and analysed, or a named group has no runs (with the nearest name).
    """
    labels = _labels(runs, terms.by, terms.period)
    reasons = [_why_excluded(run, label, terms.by) for run, label in zip(runs, labels, strict=True)]
    left_out = Counter(why for why in reasons if why)
    group_labels = ["" if why else label for why, label in zip(reasons, labels, strict=True)]
    if not any(group_labels):
        raise RefusedError(
            f"of {len(runs)} stored runs none was finished and analysed, with its {terms.by} stated"
            if runs
            else "no stored run fits",
            remedy="test sensors first, or choose other runs; cbsr-qa db status shows which database is used",
        )
    names = _names(runs, group_labels, terms)
    group_labels = [label if label in names else "" for label in group_labels]
    indices_by_test: dict[str, dict[str, list[int]]] = {name: {} for name in names}
    for index, (run, label) in enumerate(zip(runs, group_labels, strict=True)):
        if label:
            indices_by_test[label].setdefault(run.serial, []).append(index)
    tests = {name: {serial: tuple(indices) for serial, indices in indices_by_test[name].items()} for name in names}
    is_used = np.array([bool(label) for label in group_labels], dtype=bool)
    return Grouping(names, tuple(group_labels), is_used, tests, left_out)


def decides(runs: Sequence[RunLine], tests: Sequence[int], policy: Policy) -> int:
    """Return the deciding one of a sensor's runs."""
    if policy is Policy.FIRST:
        return tests[0]
    if policy is Policy.ANY:
        return next((index for index in tests if runs[index].verdict in PASSED), tests[-1])
    return tests[-1]


def period_of(moment: datetime, period: Period) -> str:
    """Name the period a moment lies in: ``2026``, ``2026-11``, ``2026-W47`` or ``2026-11-22``."""
    day = moment.astimezone(UTC).date()
    if period is Period.WEEK:
        year, week, _ = day.isocalendar()
        return f"{year}-W{week:02d}"
    return {Period.YEAR: f"{day:%Y}", Period.MONTH: f"{day:%Y-%m}"}.get(period, day.isoformat())


def _labels(runs: Sequence[RunLine], by: By, period: Period) -> list[str]:
    if by is By.SOFTWARE:
        return software_words(runs)
    if by is By.PERIOD:
        return [period_of(run.started_at, period) for run in runs]
    return [str(getattr(run, by.value)) for run in runs]


def _why_excluded(run: RunLine, label: str, by: By) -> str:
    """Why a run does not count; empty if it does."""
    if run.of_check:
        return "of golden sensors that checked a station"
    if not run.finished:
        return "that did not finish"
    if run.outcome is None:
        return "without an analysis"
    return "" if label else f"without a {by}"


def _names(runs: Sequence[RunLine], labels: Sequence[str], terms: Terms) -> tuple[str, ...]:
    """Names of the groups, the reference first: as given, or the one with most sensors and the others.

    For periods the reference is the earliest, to show changes since then.
    """
    sensors: dict[str, set[str]] = {}
    for run, label in zip(runs, labels, strict=True):
        if label:
            sensors.setdefault(label, set()).add(run.serial)
    if terms.groups:
        _check_known(terms.groups, sorted(sensors), terms.by)
        return tuple(dict.fromkeys(terms.groups))
    reference = min(sensors, key=lambda name: reference_rank(name, len(sensors[name]), terms.by))
    return (reference, *(name for name in sorted(sensors) if name != reference))


def reference_rank(name: str, sensors: int, by: By) -> tuple[int, str]:
    """Sort key of groups for the choice of a reference: the earliest period, or most sensors."""
    # Names of periods of equal length sort by time.
    return (0 if by is By.PERIOD else -sensors, name)


def _check_known(wanted: Iterable[str], known: Sequence[str], by: By) -> None:
    for name in wanted:
        if name not in known:
            raise RefusedError(
                f"no run that counts is of {by} {echo(name, 64)}", remedy=nearest(name, known, "there are")
            )


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """The crossing of the runs that count, and the meaning of its levels.

    Parameters
    ----------
    crossing : crossing of groups and stations; of batches and stations where stations are compared; of groups and
        *levels* if periods or software versions are compared: every batch at every station is a level, so that
        batches are not mistaken for periods.
    rows : (N,) indices of the runs.
    stations : stations to compare besides the groups, the one with most runs (in the part with most stations) first;
        empty for a single station, or if stations are the groups.
    levels : level → its station and batch; empty if the crossing's levels are stations.
    of_the_stations : crossing for the comparison of stations: of batches and stations if there are levels, or
        materials of several batches are compared; else the crossing itself.
    """

    terms: Terms
    crossing: Crossing
    rows: IntArray
    stations: tuple[str, ...]
    levels: Mapping[str, tuple[str, str]]
    of_the_stations: Crossing

    @property
    def noun(self) -> str:
        return _GROUPS.get(self.terms.by, str(self.terms.by))

    @property
    def of_stations(self) -> bool:
        return self.terms.by is By.STATION

    def common_batches(self, first: str, second: str) -> tuple[str, ...]:
        """Return the batches that ran at one station in both groups, the main basis of their difference."""
        first_levels, second_levels = (_levels_of(self.crossing).get(name, frozenset()) for name in (first, second))
        return tuple(sorted({self.levels[level][1] for level in first_levels & second_levels}))

    def untold(self, crossing: Crossing, first: str, second: str) -> str:
        """Explain why two groups cannot be separated; empty if the crossing's own message suffices.

        Parameters
        ----------
        found : the crossing of the runs with a value.
        """
        level_names = crossing.stations if self.of_stations else crossing.groups
        absent = [name for name in (first, second) if name not in level_names]
        if absent:
            return f"no run of {' and of '.join(absent)} that counts has a value of it"
        if (
            not self.levels
            or crossing.group_parts[level_names.index(first)] == crossing.group_parts[level_names.index(second)]
        ):
            return ""
        unconnected = []
        for side in (1, 0):  # batches alone, stations alone
            joined = _cross_levels(self, crossing, side)
            parts = [int(joined.group_parts[joined.index("group", name)]) for name in (first, second)]
            unconnected.append(parts[0] != parts[1])
        batches, stations = unconnected
        inseparable = "batches" if batches and not stations else "stations" if stations and not batches else ""
        problem = (
            f"and {inseparable} cannot be told apart"
            if inseparable
            else "cannot be separated from batches and stations"
        )
        levels_of_groups = "; ".join(
            f"{name} is {self._words(crossing, name, inseparable)}" for name in (first, second)
        )
        return f"{self.noun}s {problem}: {levels_of_groups}; run some sensors of one batch at one station in both"

    def _words(self, crossing: Crossing, name: str, other: str) -> str:
        pairs = sorted(self.levels[level] for level in _levels_of(crossing)[name])
        if other:
            names = {_batch(batch) if other == "batches" else station for station, batch in pairs}
            return f"{list_names(sorted(names))} only"
        return list_names([f"{_batch(batch)} at {station}" for station, batch in pairs], 3)


def design_of(runs: Sequence[RunLine], grouping: Grouping, terms: Terms) -> Design:
    """Cross the runs that count."""
    rows = np.flatnonzero(grouping.used)
    members = [runs[row] for row in rows.tolist()]
    labels = [grouping.labels[row] for row in rows.tolist()]
    stations, serials = [run.station for run in members], [run.serial for run in members]
    batches = [run.batch or NO_BATCH for run in members]
    if terms.by is By.STATION:  # batches must not be mistaken for stations
        group_crossing = crossing(batches, stations, serials)
        return Design(terms, group_crossing, rows, (), {}, group_crossing)
    if terms.by in _GROUPS and len(set(batches)) > 1:
        levels = {_level(run): (run.station, run.batch or NO_BATCH) for run in members}
        group_crossing = crossing(labels, [_level(run) for run in members], serials)
        station_crossing = crossing(batches, stations, serials)  # as for stations as groups, so that both agree
        return Design(
            terms,
            group_crossing,
            rows,
            _comparable_stations(station_crossing),
            levels,
            station_crossing,
        )
    group_crossing = crossing(labels, stations, serials)
    # Batches of a material differ, and stations have different ones.
    station_crossing = (
        crossing(batches, stations, serials) if terms.by is By.MATERIAL and len(set(batches)) > 1 else group_crossing
    )
    return Design(terms, group_crossing, rows, _comparable_stations(station_crossing), {}, station_crossing)


def _comparable_stations(made: Crossing) -> tuple[str, ...]:
    """Stations to compare, or none.

    The first one has most runs in the part with most stations, so that others can be compared with it.
    """
    if len(made.stations) < 2:
        return ()
    size, runs = np.bincount(made.station_parts), np.bincount(made.station)
    order = np.lexsort((-runs, -size[made.station_parts]))
    return tuple(made.stations[index] for index in order)


def _level(run: RunLine) -> str:
    return f"{run.station} ({_batch(run.batch or NO_BATCH)})"


def _batch(name: str) -> str:
    return name if name == NO_BATCH else f"batch {name}"


@lru_cache(maxsize=4)
def _levels_of(crossing: Crossing) -> Mapping[str, frozenset[str]]:
    """Group → levels of its runs; cached, as it is needed for every pair of groups in a metric."""
    pairs = np.unique(crossing.group * len(crossing.stations) + crossing.station)
    levels_by_group: dict[str, set[str]] = {}
    for group, level in zip(*divmod(pairs, len(crossing.stations)), strict=True):
        levels_by_group.setdefault(crossing.groups[group], set()).add(crossing.stations[level])
    return {name: frozenset(levels) for name, levels in levels_by_group.items()}


@lru_cache(maxsize=4)
def _cross_levels(design: Design, crossed: Crossing, side: int) -> Crossing:
    """Groups crossed with the batches (side 1) or the stations (side 0) of their levels."""
    pairs = sorted(
        {(name, design.levels[level][side]) for name, levels in _levels_of(crossed).items() for level in levels}
    )
    groups = [group for group, _ in pairs]
    return crossing(groups, [other for _, other in pairs], groups)


def choose_reference(
    grouping: Grouping, design: Design, measured: BoolArray, terms: Terms
) -> tuple[Grouping, list[str]]:
    """Put a group first that most others can be compared with, unless groups were named; and return notes.

    Parameters
    ----------
    measured : (R,) whether a run has any value.
    """
    part_of = _parts(grouping, design, measured)
    sizes = Counter(part_of.values())
    usual = grouping.reference
    best = min(
        grouping.names,
        key=lambda name: (-sizes[part_of[name]], *reference_rank(name, len(grouping.tests[name]), terms.by)),
    )
    if sizes[part_of[best]] < 2 or sizes[part_of[best]] <= sizes[part_of[usual]]:
        return grouping, []
    members = [name for name in grouping.names if part_of[name] == part_of[best]]
    if terms.groups:
        if sizes[part_of[usual]] > 1:
            return grouping, []
        note = f"Nothing can be compared with {usual}; {list_names(members)} can among themselves"
        return grouping, [f"{note}: --groups {','.join(members)}"]
    reason = "is the earliest" if terms.by is By.PERIOD else "has most sensors"
    note = f"The reference is {best}: {usual} {reason}, and cannot be compared with {list_names(members)}"
    return replace(grouping, names=(best, *(name for name in sorted(grouping.names) if name != best))), [note]


def _parts(grouping: Grouping, design: Design, measured: BoolArray) -> dict[str, int]:
    """Group → its connected part; a group without a value is a separate part."""
    isolated_parts = {name: -1 - place for place, name in enumerate(grouping.names)}
    has_value = measured[design.rows]
    if not has_value.any():
        return isolated_parts
    measured_crossing = design.crossing.select_runs(has_value)
    names, parts = (
        (measured_crossing.stations, measured_crossing.station_parts)
        if design.of_stations
        else (measured_crossing.groups, measured_crossing.group_parts)
    )
    return isolated_parts | dict(zip(names, parts.tolist(), strict=True))
