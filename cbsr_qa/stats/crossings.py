"""Designs of groups and stations: which differences the runs can estimate.

Groups and stations are the two sides of a graph; every run joins its group to its station. Differences between
groups, adjusted for stations, can be estimated only within a connected part of the graph (Searle 1971, section 7.4).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from cbsr_qa.domain.errors import NumericsError

IntArray = NDArray[np.intp]
SparseArray: TypeAlias = "sparse.csr_array[np.float64, tuple[int, int]]"


@dataclass(frozen=True, slots=True)
class Part:
    """Groups and stations connected by runs, each sorted by name."""

    groups: tuple[str, ...]
    stations: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Crossing:
    """Design of N runs.

    Parameters
    ----------
    groups, stations, sensors : names, sorted; each occurs in at least one run.
    group, station, sensor : (N,) indices of each run's names.
    group_parts, station_parts : connected part of each group and station, numbered from 0.
    """

    groups: tuple[str, ...]
    stations: tuple[str, ...]
    sensors: tuple[str, ...]
    group: IntArray
    station: IntArray
    sensor: IntArray
    group_parts: IntArray
    station_parts: IntArray

    @property
    def parts(self) -> tuple[Part, ...]:
        """The connected parts; a difference between two of them is confounded with their stations."""
        return tuple(
            Part(
                _names_in_part(self.groups, self.group_parts, part),
                _names_in_part(self.stations, self.station_parts, part),
            )
            for part in range(int(self.group_parts.max()) + 1)
        )

    def select_runs(self, runs: NDArray[np.bool_] | IntArray) -> "Crossing":
        """Return the design of a subset of the runs, e.g. of those with a metric."""
        factors = ((self.groups, self.group), (self.stations, self.station), (self.sensors, self.sensor))
        coded = []
        for names, codes in factors:
            used_codes, inverse = np.unique(codes[runs], return_inverse=True)
            coded.append((tuple(names[code] for code in used_codes), inverse.astype(np.intp)))
        return _crossing(coded)

    def first_runs(self) -> IntArray:
        return np.unique(self.sensor, return_index=True)[1]

    def columns(self) -> SparseArray:
        """Return the (N, p) model matrix: one column per group, and per station but the first of each part.

        Its rank is p: within a connected part the only dependence is that group and station columns have the same
        sum.
        """
        runs, width = len(self.group), len(self.groups) + len(self.stations)
        places = np.concatenate([self.group, len(self.groups) + self.station])
        rows = np.tile(np.arange(runs), 2)
        matrix = sparse.coo_array((np.ones(2 * runs), (rows, places)), shape=(runs, width))
        return matrix.tocsc()[:, np.flatnonzero(self.independent_columns())].tocsr()

    def independent_columns(self) -> NDArray[np.bool_]:
        """Return which columns of groups and stations the model matrix has."""
        firsts = np.unique(self.station_parts, return_index=True)[1]
        is_kept = np.ones(len(self.groups) + len(self.stations), dtype=bool)
        is_kept[len(self.groups) + firsts] = False
        return is_kept

    def same_part(self, first: str, second: str) -> None:
        """Refuse to compare groups that no stations connect.

        Raises
        ------
        NumericsError
            Naming both parts; or a group that is not in the design.
        """
        part, other = (int(self.group_parts[self.index("group", name)]) for name in (first, second))
        if part != other:
            parts = self.parts
            raise NumericsError(
                f"{first} and {second} cannot be compared: {_list_names(parts[part].groups)} ran on "
                f"{_list_names(parts[part].stations)} only and {_list_names(parts[other].groups)} on "
                f"{_list_names(parts[other].stations)} only, so stations may cause the difference",
                remedy=f"measure some sensors of both on one station, e.g. of {second} on {parts[part].stations[0]}",
            )

    def index(self, kind: str, name: str) -> int:
        """Return the index of a ``"group"`` or ``"station"``; NumericsError if unknown."""
        names = self.groups if kind == "group" else self.stations
        if name not in names:
            raise NumericsError(f"no used run has {kind} {name!r}; used are {_list_names(names)}")
        return names.index(name)


def crossing(groups: Sequence[str], stations: Sequence[str], sensors: Sequence[str]) -> Crossing:
    """Return the design of runs.

    Parameters
    ----------
    groups, stations, sensors : (N,) names of each run.

    Raises
    ------
    NumericsError
        No runs, columns of different lengths, or a run without a name.
    """
    columns = {"group": groups, "station": stations, "sensor": sensors}
    lengths = {len(column) for column in columns.values()}
    if len(lengths) > 1 or not groups:
        counts = ", ".join(f"{len(column)} {kind}s" for kind, column in columns.items())
        raise NumericsError(f"design: {counts}; there must be at least one run, and every run needs one of each")
    for kind, column in columns.items():
        if not all(column):
            run = next(index for index, name in enumerate(column) if not name)
            raise NumericsError(f"design: the run at index {run} has no {kind}", remedy="leave it out, and report it")
    coded = []
    for column in columns.values():
        names = tuple(sorted(set(column)))
        codes = {name: code for code, name in enumerate(names)}
        coded.append((names, np.array([codes[name] for name in column], dtype=np.intp)))
    return _crossing(coded)


def _crossing(coded: Sequence[tuple[tuple[str, ...], IntArray]]) -> Crossing:
    (groups, group), (stations, station), (sensors, sensor) = coded
    if not len(group):
        raise NumericsError("design: no runs remain")
    nodes = len(groups) + len(stations)
    edges = sparse.coo_array((np.ones(len(group)), (group, len(groups) + station)), shape=(nodes, nodes))
    labels = connected_components(edges.tocsr(), directed=False)[1].astype(np.intp)
    return Crossing(groups, stations, sensors, group, station, sensor, labels[: len(groups)], labels[len(groups) :])


def _names_in_part(names: tuple[str, ...], parts: IntArray, part: int) -> tuple[str, ...]:
    return tuple(names[index] for index in np.flatnonzero(parts == part))


def _list_names(names: Sequence[str]) -> str:
    first_names = ", ".join(names[:5])
    return f"{first_names} and {len(names) - 5} more" if len(names) > 5 else first_names
