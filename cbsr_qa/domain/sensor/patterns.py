"""Drive and measurement patterns: electrode pairs, canonical order of readings, number of independent readings."""

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import Array, is_whole

#: Coefficients by unknown; none is zero.
Functional = dict[tuple[int, int], int]

#: Share of the largest eigenvalue below which others count as zero. Coefficients are small whole numbers.
_ZERO: Final = 1e-10


def rank_of(functionals: Sequence[Functional]) -> int:
    """Return the rank of functionals with few entries each.

    One with an unknown that no other has is independent of them; it is counted and taken away, which may free the
    next. Little is left of patterns without a system, nothing of ``"adjacent"``; the rest is counted by eigenvalues.
    """
    holders: dict[tuple[int, int], set[int]] = defaultdict(set)
    for row, functional in enumerate(functionals):
        for unknown in functional:
            holders[unknown].add(row)
    rows_left = set(range(len(functionals)))
    free_unknowns = [unknown for unknown, rows in holders.items() if len(rows) == 1]
    while free_unknowns:
        rows = holders[free_unknowns.pop()]
        if not rows:
            continue
        (row,) = rows
        rows_left.discard(row)
        for unknown in functionals[row]:
            holders[unknown].discard(row)
            if len(holders[unknown]) == 1:
                free_unknowns.append(unknown)
    core = [functionals[row] for row in sorted(rows_left)]
    return len(functionals) - len(core) + _dense_rank(core)


def _dense_rank(functionals: Sequence[Functional]) -> int:
    if not functionals:
        return 0
    unknowns = {unknown: k for k, unknown in enumerate(sorted({u for f in functionals for u in f}))}
    matrix: Array = np.zeros((len(functionals), len(unknowns)))
    for row, functional in enumerate(functionals):
        for unknown, coefficient in functional.items():
            matrix[row, unknowns[unknown]] = coefficient
    gram = matrix @ matrix.T if len(functionals) <= len(unknowns) else matrix.T @ matrix
    eigenvalues = np.linalg.eigvalsh(gram)
    return int((eigenvalues > _ZERO * eigenvalues[-1]).sum())


#: Share of readings that touch no driven electrode below which a pattern reads across the driven ones.
_FEW_CLEAR: Final = 0.1

Pair = tuple[int, int]
Pairs = tuple[Pair, ...]

#: Fewest independent readings for a meaningful image.
FEWEST_INDEPENDENT: Final = 8


@dataclass(frozen=True, slots=True)
class DrivePattern:
    """Drive and measure pairs. Frames are stored as (drive, measure), independent of the scan order.

    A pair may occur again, or reversed: rigs repeat injections against noise and reverse the current to tell
    offsets from signal. Each of the readings has noise of its own; it adds no independent reading.

    Parameters
    ----------
    electrode_count : electrodes on the sensor.
    drive : pairs (source, sink), current flows in at the first.
    measure : pairs (plus, minus), the reading is U[plus] − U[minus].

    Raises
    ------
    RefusedError
        If there are no pairs, or a pair joins an electrode with itself, or names an electrode that is not there, or
        not by a whole number.
    """

    electrode_count: int
    drive: Pairs
    measure: Pairs

    def __post_init__(self) -> None:
        for kind, pairs in (("drive", self.drive), ("measure", self.measure)):
            problem = next(pair_problems(pairs, self.electrode_count), None)
            if problem is not None:
                index, problem_words = problem
                where = "" if index is None else f"pair {index + 1} {pairs[index]} of "
                raise RefusedError(f"{where}the {kind} pattern {problem_words}")

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of one frame: (drive pairs, measure pairs)."""
        return len(self.drive), len(self.measure)

    def drive_currents(self) -> Array:
        """Unit current of each drive pair into each electrode.

        Returns
        -------
        (electrodes, drive pairs) float64 of +1, −1 and 0.
        """
        return _incidence(self.electrode_count, self.drive)

    def measure_matrix(self) -> Array:
        """Matrix from electrode potentials to readings: readings = potentials.T @ this.

        Returns
        -------
        (electrodes, measure pairs) float64 of +1, −1 and 0.
        """
        return _incidence(self.electrode_count, self.measure)

    def usable(self) -> NDArray[np.bool_]:
        """Readings that touch no driven electrode: 208 of 256 for adjacent/adjacent on 16.

        Returns
        -------
        (drive pairs, measure pairs) bool.
        """
        driven, measured = self.drive_currents() != 0, self.measure_matrix() != 0
        touched = driven.T.astype(np.float64) @ measured.astype(np.float64)
        usable: NDArray[np.bool_] = touched == 0
        return usable

    def select_imaged(self, recorded: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Readings to image from: of those recorded, the ones that touch no driven electrode.

        If these are less than a tenth, the instrument reads across the driven electrodes, as an ohmmeter does between
        two of them, and all recorded readings are taken. They hold the contacts of these electrodes.

        Parameters
        ----------
        recorded : (drive pairs, measure pairs) bool.
        """
        clear = self.usable() & recorded
        return clear if clear.sum() >= _FEW_CLEAR * recorded.sum() else recorded

    def touching(self, electrodes: Sequence[int]) -> NDArray[np.bool_]:
        """Readings (drive pairs, measure pairs) bool that drive or measure with some electrodes."""
        indices = list(electrodes)
        driven = (self.drive_currents()[indices] != 0).any(axis=0)
        measured = (self.measure_matrix()[indices] != 0).any(axis=0)
        touching: NDArray[np.bool_] = driven[:, None] | measured
        return touching

    def list_silent_drives(self, failed: NDArray[np.bool_], counted: NDArray[np.bool_]) -> list[tuple[int, int]]:
        """Drive pairs of which every counted reading failed, and one at least is counted.

        Parameters
        ----------
        failed, counted : (drives, measures) bool.
        """
        rows = zip(self.drive, failed, counted, strict=True)
        return [pair for pair, row, used in rows if used.any() and row[used].all()]

    def reading_groups(self) -> tuple[NDArray[np.int64], Array]:
        """Groups of readings that are equal, up to sign, on every sheet that obeys Ohm's law.

        By reciprocity exchanging the driven and the measured pair changes nothing; reversing one of them changes
        the sign.

        Returns
        -------
        group : (drive pairs, measure pairs) int64, numbered from 0 in the order of their first readings.
        sign : (drive pairs, measure pairs) float64 of ±1; reading times sign is the same within a group.
        """
        numbers: dict[tuple[Pair, Pair], int] = {}
        keys = [(_key(d, m), _sign(d) * _sign(m)) for d in self.drive for m in self.measure]
        group = np.array([numbers.setdefault(key, len(numbers)) for key, _ in keys], dtype=np.int64)
        sign = np.array([sign for _, sign in keys], dtype=np.float64)
        return group.reshape(self.shape), sign.reshape(self.shape)

    def reciprocal_pairs(self) -> tuple[NDArray[np.int64], Array]:
        """Reciprocal readings as pairs: the first of every group with each of the others.

        Returns
        -------
        readings : (k, 2) int64, indices into a frame in C order, rising.
        sign : (k,) float64 of ±1: first = sign · second on every sheet that obeys Ohm's law.
        """
        groups, signs = self.reading_groups()
        group, sign = groups.ravel(), signs.ravel()
        _, first = np.unique(group, return_index=True)
        of_first = first[group]
        repeated = np.flatnonzero(of_first != np.arange(group.size))
        equal: Array = sign[of_first[repeated]] * sign[repeated]
        return np.column_stack([of_first[repeated], repeated]).astype(np.int64), equal

    def independent_readings(self, used: NDArray[np.bool_] | None = None) -> int:
        """Count the independent readings: 104 of the 208 of adjacent/adjacent on 16.

        A reading is a linear function of the sheet's symmetric transfer impedance; counted is the rank of these.
        No pattern on n electrodes has more than n(n − 1)/2. Up to 64 electrodes it takes less than a second; pairs
        that skip electrodes take minutes on twice as many.

        Parameters
        ----------
        used : (drive pairs, measure pairs) bool; by default the usable ones.
        """
        return rank_of(_functionals(self, self.usable() if used is None else used))

    def too_few_readings(self, used: NDArray[np.bool_]) -> int | None:
        """Number of independent readings if too few for an image, else None.

        :data:`FEWEST_INDEPENDENT` are enough. Counting stops there, as it takes long with many electrodes.

        Parameters
        ----------
        used : (drive pairs, measure pairs) bool.
        """
        functionals = _functionals(self, used)
        if rank_of(functionals[: 4 * FEWEST_INDEPENDENT]) >= FEWEST_INDEPENDENT:
            return None
        independent = rank_of(functionals)
        return independent if independent < FEWEST_INDEPENDENT else None


def adjacent_pattern(electrode_count: int) -> DrivePattern:
    """Pair k joins electrodes k and k+1, for driving and measuring (the rig's pattern)."""
    return DrivePattern(electrode_count, *(2 * [list_pairs("adjacent", electrode_count)]))


def list_pairs(name: str, electrode_count: int) -> Pairs:
    """Pairs of a named rule.

    Parameters
    ----------
    name : ``"adjacent"``: k and k + 1; ``"skip-n"``: k and k + n + 1, all round; ``"opposite"``: k and
        k + count/2, each pair once.

    Raises
    ------
    RefusedError
        If there is no such rule, or it does not suit this number of electrodes.
    """
    if not is_rule(name):
        raise RefusedError(
            f"unknown pattern {name!r}", remedy="allowed: 'adjacent', 'opposite', 'skip-1', 'skip-2' and so on"
        )
    widest = (electrode_count - 1) // 2 - 1
    if name == "opposite":
        half_way = electrode_count // 2
        if electrode_count % 2:
            raise RefusedError(
                f"no two of {electrode_count} electrodes are opposite each other", remedy=f"use 'skip-{widest}'"
            )
        return tuple((k, k + half_way) for k in range(half_way))
    skipped = 0 if name == "adjacent" else int(name.removeprefix("skip-"))
    # Half way round is 'opposite'; further round come the same pairs reversed.
    if skipped > max(widest, 0):
        raise RefusedError(
            f"skipping {skipped} spans half of {electrode_count} electrodes or more",
            remedy=f"use 'skip-{widest}' or less" + (", or 'opposite'" if electrode_count % 2 == 0 else ""),
        )
    return tuple((k, (k + skipped + 1) % electrode_count) for k in range(electrode_count))


def is_rule(name: str) -> bool:
    """Whether a pair rule of this name exists; it may still not suit a number of electrodes."""
    return re.fullmatch(r"adjacent|opposite|skip-\d{1,3}", name) is not None


def pair_problems(pairs: Sequence[Sequence[int]], electrode_count: int) -> Iterator[tuple[int | None, str]]:
    """Yield problems of drive or measure pairs: the pair (from 0; None for all) and a description."""
    if not len(pairs):
        yield None, "has no pairs"
    for index, pair in enumerate(pairs):
        uncounted = [electrode for electrode in pair if not is_whole(electrode)]
        if uncounted:
            yield index, f"names electrode {uncounted[0]!r}; electrodes have whole numbers"
            continue
        unknown_electrodes = [electrode for electrode in pair if not 0 <= electrode < electrode_count]
        if len(pair) != 2:
            yield index, f"has {len(pair)} electrodes instead of two"
        elif unknown_electrodes:
            yield index, f"names electrode {unknown_electrodes[0]}; allowed: 0 to {electrode_count - 1}"
        elif pair[0] == pair[1]:
            yield index, f"pairs electrode {pair[0]} with itself"


def imaging_problems(pattern: DrivePattern) -> Iterator[str]:
    """Yield why a pattern of valid pairs cannot be imaged."""
    named = {electrode for pair in (*pattern.drive, *pattern.measure) for electrode in pair}
    idle = sorted(set(range(pattern.electrode_count)) - named)
    if idle:
        idle_names = ", ".join(map(str, idle[:6])) + (f" and {len(idle) - 6} more" if len(idle) > 6 else "")
        yield f"never uses electrode{'s' if len(idle) > 1 else ''} {idle_names}; leave out what is not connected"
    independent = pattern.too_few_readings(pattern.usable())
    if independent is not None:
        yield (
            f"gives {independent} independent readings ({int(pattern.usable().sum())} touch no driven electrode);"
            f" at least {FEWEST_INDEPENDENT} are needed to image"
        )


def _sign(pair: Pair) -> int:
    return 1 if pair[0] < pair[1] else -1


def _key(drive: Pair, measure: Pair) -> tuple[Pair, Pair]:
    """Canonical name of a reading, equal for its reciprocal and for reversed pairs."""
    first, second = sorted(((min(drive), max(drive)), (min(measure), max(measure))))
    return first, second


def _functionals(pattern: DrivePattern, used: NDArray[np.bool_]) -> list[Functional]:
    """Functionals of the used readings; reciprocal ones share one."""
    distinct_keys = {_key(pattern.drive[d], pattern.measure[m]) for d, m in np.argwhere(used)}
    return [_functional(*key) for key in sorted(distinct_keys)]


def _functional(first: Pair, second: Pair) -> Functional:
    """Coefficients of a reading over the entries of the symmetric transfer impedance."""
    entries: dict[Pair, int] = {}
    for i, plus in zip(first, (1, -1), strict=True):
        for j, also in zip(second, (1, -1), strict=True):
            entry = (min(i, j), max(i, j))
            entries[entry] = entries.get(entry, 0) + plus * also
    return entries


def _incidence(electrode_count: int, pairs: Pairs) -> Array:
    matrix = np.zeros((electrode_count, len(pairs)))
    for column, (plus, minus) in enumerate(pairs):
        matrix[plus, column] += 1
        matrix[minus, column] -= 1
    return matrix


def find_shared_electrode(pairs: Sequence[tuple[int, int]]) -> int | None:
    """Return the one electrode of all these pairs: its lead is open, where they are the ones that fail.

    None of fewer than two pairs, and if they share none or two.
    """
    shared = set.intersection(*(set(pair) for pair in pairs)) if len(pairs) > 1 else set()
    return shared.pop() if len(shared) == 1 else None
