"""``[material.strip_relaxation]``: how a strip of the material relaxed, with errors."""

from collections.abc import Iterator
from typing import Annotated

import numpy as np
from pydantic import Field

from cbsr_qa.config.lines import KeyPath
from cbsr_qa.config.tables import Problem, Table
from cbsr_qa.domain.sensor import MeasuredKernel, StripRelaxation

Positive = Annotated[float, Field(gt=0)]
Strain = Annotated[float, Field(gt=0, lt=1)]
#: Digits that are lost when a covariance is written by hand.
_ROUNDING = 1e-3
#: No characterisation tells more exponentials than this.
_MOST = 4


class MeasuredKernelTable(Table):
    """Weights and time constants, with the covariance of (weights, logarithms of the time constants)."""

    weights: Annotated[list[float], Field(min_length=1, max_length=_MOST)]
    time_constants_s: Annotated[list[Positive], Field(min_length=1, max_length=_MOST)]
    covariance: Annotated[
        list[Annotated[list[float], Field(max_length=2 * _MOST)]], Field(min_length=2, max_length=2 * _MOST)
    ]
    start_s: Annotated[float, Field(ge=0)]
    window_s: Positive

    def problems(self, where: KeyPath) -> Iterator[Problem]:
        """Yield what does not fit together within the table."""
        count = len(self.weights)
        if len(self.time_constants_s) != count:
            what = f"has {len(self.time_constants_s)} numbers, weights {count}; one for each"
            yield Problem((*where, "time_constants_s"), what)
        elif any(len(row) != 2 * count for row in self.covariance) or len(self.covariance) != 2 * count:
            what = f"must have {2 * count} rows of {2 * count} numbers: of weights, then of log time constants"
            yield Problem((*where, "covariance"), what)
        else:
            yield from self._no_covariance(where)
        if self.start_s >= self.window_s:
            what = f"is {self.start_s:g} s; must be below window_s, {self.window_s:g} s"
            yield Problem((*where, "start_s"), what)

    def _no_covariance(self, where: KeyPath) -> Iterator[Problem]:
        """Yield why these numbers are no covariance: some combination would have a negative variance."""
        given = np.array(self.covariance)
        diagonal = np.diag(given)
        scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        correlation = given / scale / scale[:, None]
        if not np.allclose(correlation, correlation.T, atol=_ROUNDING):
            yield Problem((*where, "covariance"), "must be symmetric")
        elif diagonal.min() < 0 or np.linalg.eigvalsh(correlation).min() < -_ROUNDING:
            yield Problem((*where, "covariance"), "is no covariance: a variance would be negative")

    def to_domain(self) -> MeasuredKernel:
        """Return the kernel."""
        return MeasuredKernel(
            tuple(self.weights),
            tuple(self.time_constants_s),
            tuple(tuple(row) for row in self.covariance),
            self.start_s,
            self.window_s,
        )


class StripRelaxationTable(Table):
    """What it was learned from, and a table for each direction that could be told."""

    cycles: Annotated[int, Field(gt=0)]
    least_strain: Strain
    largest_strain: Strain
    source: Annotated[str, Field(min_length=1, max_length=1000)]
    loading: MeasuredKernelTable | None = None
    unloading: MeasuredKernelTable | None = None

    def problems(self, where: KeyPath) -> Iterator[Problem]:
        """Yield what does not fit together within the table and those below it."""
        if self.least_strain > self.largest_strain:
            what = f"is {self.least_strain:g}, above largest_strain, {self.largest_strain:g}"
            yield Problem((*where, "least_strain"), what)
        for name, kernel in (("loading", self.loading), ("unloading", self.unloading)):
            if kernel is not None:
                yield from kernel.problems((*where, name))

    def to_domain(self) -> StripRelaxation:
        """Return the relaxation."""
        return StripRelaxation(
            None if self.loading is None else self.loading.to_domain(),
            None if self.unloading is None else self.unloading.to_domain(),
            self.cycles,
            self.least_strain,
            self.largest_strain,
            self.source,
        )
