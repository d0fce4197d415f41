"""The design of a comparison: which runs cross which groups, stations and batches."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from cbsr_qa.domain.results import FleetRun
from cbsr_qa.stats import Crossing, IntArray, crossing
from cbsr_qa.studies.compare.figures import named
from cbsr_qa.studies.compare.groups import Grouping
from cbsr_qa.studies.compare.terms import By

#: What a run without a batch is of.
NO_BATCH: Final = "batch not stated"
#: Groupings that have nothing to do with batches, and may yet coincide with them.
_GROUPS: Final = {By.PERIOD: "period", By.SOFTWARE: "software version"}


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """The crossing of the runs that count, and what its levels stand for.

    Parameters
    ----------
    crossing : of groups and stations; of batches and stations where stations are compared; of groups and *levels*
        where periods or software versions are: every batch at every station is a level, so that no batch is taken
        for a period.
    rows : (N,) indices of the runs.
    stations : to compare beside the groups, that with most runs (of the part with most stations) first; none where
        there is one, or they are groups.
    levels : level → its station and batch; empty where the crossing's levels are stations.
    of_the_stations : crossing by which the stations are compared: of batches and stations where there are levels,
        or materials of several batches are compared; else the crossing itself.
    sides : (R,) what the crossing has on its other side, of every run: a level, or a station.
    """

    by: By
    crossing: Crossing
    rows: IntArray
    stations: tuple[str, ...]
    levels: Mapping[str, tuple[str, str]]
    of_the_stations: Crossing
    sides: tuple[str, ...]

    @property
    def noun(self) -> str:
        """What one group is, in words."""
        return _GROUPS.get(self.by, str(self.by))

    @property
    def of_stations(self) -> bool:
        """Whether stations are the groups."""
        return self.by is By.STATION

    def shared(self, first: str, second: str) -> tuple[str, ...]:
        """Return the batches that ran at one station in both groups: what their difference rests on most."""
        one, two = (_levels_of(self.crossing).get(name, frozenset()) for name in (first, second))
        return tuple(sorted({self.levels[level][1] for level in one & two}))

    def untold(self, found: Crossing, first: str, second: str) -> str:
        """Say why two groups cannot be told apart; empty where the crossing's own words will do.

        Parameters
        ----------
        found : the crossing of the runs that have a value.
        """
        known = found.stations if self.of_stations else found.groups
        absent = [name for name in (first, second) if name not in known]
        if absent:
            return f"no run of {' and of '.join(absent)} that counts has a value of it"
        if not self.levels or found.group_parts[known.index(first)] == found.group_parts[known.index(second)]:
            return ""
        batches, stations = (self._apart(found, (first, second), side) for side in (1, 0))
        other = "batches" if batches and not stations else "stations" if stations and not batches else ""
        told = f"and {other} cannot be told apart" if other else "cannot be told from batches and stations"
        where = "; ".join(f"{name} is {self._words(found, name, other)}" for name in (first, second))
        return f"{self.noun}s {told}: {where}; run some sensors of one batch at one station in both"

    def _apart(self, found: Crossing, names: tuple[str, str], side: int) -> bool:
        """Whether nothing connects two groups by batches (side 1) or stations (side 0) alone."""
        joined = _joined(self, found, side)
        one, two = (int(joined.group_parts[joined.index("group", name)]) for name in names)
        return one != two

    def _words(self, found: Crossing, name: str, other: str) -> str:
        pairs = sorted(self.levels[level] for level in _levels_of(found)[name])
        if other:
            seen = {_batch(batch) if other == "batches" else station for station, batch in pairs}
            return f"{named(sorted(seen))} only"
        return named([f"{_batch(batch)} at {station}" for station, batch in pairs], 3)


def design_of(runs: Sequence[FleetRun], grouping: Grouping, by: By) -> Design:
    """Cross the runs that count."""
    rows = np.flatnonzero(grouping.used)
    members = [runs[row] for row in rows.tolist()]
    labels = [grouping.labels[row] for row in rows.tolist()]
    stations, serials = [run.station for run in members], [run.serial for run in members]
    batches = [run.batch or NO_BATCH for run in members]
    at = tuple(run.station for run in runs)
    if by is By.STATION:  # what must not be taken for a station is the batch
        made = crossing(batches, stations, serials)
        return Design(by, made, rows, (), {}, made, at)
    if by in _GROUPS and len(set(batches)) > 1:
        levels = {_level(run): (run.station, run.batch or NO_BATCH) for run in members}
        made = crossing(labels, [_level(run) for run in members], serials)
        beside = crossing(batches, stations, serials)  # as where stations are the groups, so that both say one thing
        return Design(by, made, rows, _by_runs(beside), levels, beside, tuple(_level(run) for run in runs))
    made = crossing(labels, stations, serials)
    # Batches of a material differ, and not every station has the same ones.
    beside = crossing(batches, stations, serials) if by is By.MATERIAL and len(set(batches)) > 1 else made
    return Design(by, made, rows, _by_runs(beside), {}, beside, at)


def _by_runs(made: Crossing) -> tuple[str, ...]:
    """Stations; none where there is nothing to compare.

    First comes that with most runs in the part with most stations, so that something can be compared with it.
    """
    if len(made.stations) < 2:
        return ()
    size, runs = np.bincount(made.station_parts), np.bincount(made.station)
    order = np.lexsort((-runs, -size[made.station_parts]))
    return tuple(made.stations[index] for index in order)


def _level(run: FleetRun) -> str:
    return f"{run.station} ({_batch(run.batch or NO_BATCH)})"


def _batch(name: str) -> str:
    return name if name == NO_BATCH else f"batch {name}"


@lru_cache(maxsize=4)
def _levels_of(found: Crossing) -> Mapping[str, frozenset[str]]:
    """Group → the levels its runs have; kept, because every pair of groups in a metric asks."""
    pairs = np.unique(found.group * len(found.stations) + found.station)
    seen: dict[str, set[str]] = {}
    for group, level in zip(*divmod(pairs, len(found.stations)), strict=True):
        seen.setdefault(found.groups[group], set()).add(found.stations[level])
    return {name: frozenset(levels) for name, levels in seen.items()}


@lru_cache(maxsize=4)
def _joined(design: Design, found: Crossing, side: int) -> Crossing:
    """Groups crossed with the batches (side 1) or the stations (side 0) of their levels."""
    pairs = sorted({(name, design.levels[one][side]) for name, levels in _levels_of(found).items() for one in levels})
    groups = [group for group, _ in pairs]
    return crossing(groups, [other for _, other in pairs], groups)
