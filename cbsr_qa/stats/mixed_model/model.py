"""Mixed model of groups across stations with sensors as a random effect.

    y = group (fixed) + station (fixed) + sensor (random, σ²θ) + run (σ²)

by restricted maximum likelihood (:mod:`.reml`), intervals by Kenward & Roger's covariance and degrees of freedom. The
model is additive. Where no sensor has more than one run, ordinary least squares gives the same estimates with exact t
intervals.
"""

from dataclasses import dataclass
from enum import StrEnum
from math import log, sqrt
from typing import Protocol

import numpy as np
from scipy import linalg

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.crossings import Crossing
from cbsr_qa.stats.difference import Contrast, make_contrast
from cbsr_qa.stats.mixed_model.reml import (
    RandomEffectSums,
    Ratio,
    random_effect_sums,
    small_sample,
    variance_ratio,
)
from cbsr_qa.stats.samples import LEAST_SPREAD, Interval, sample, subtract_mean
from cbsr_qa.stats.variance_components import FEWEST_REPEATS


class Model(StrEnum):
    """The fitted model."""

    MIXED = "mixed: group and station fixed, sensor random"
    FIXED = "fixed: group and station, one run a sensor"
    SESSIONS = "mixed: group and station fixed, sensor and session random"


class ContrastFreedom(Protocol):
    """Basis of the degrees of freedom of a contrast."""

    def freedom(self, contrast: Array) -> float:
        """Return the degrees of freedom of one contrast (p,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """Deviation between runs of a sensor (0 where no sensor has two), and between sensors of each group (g,)."""

    run_deviation: float
    sensor_deviations: Array

    def scale(self, factor: float) -> "Scatter":
        """Return the deviations of values multiplied by a factor."""
        return Scatter(factor * self.run_deviation, factor * self.sensor_deviations)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A fitted model, in the unit of its values.

    Parameters
    ----------
    design : design of the fitted runs.
    effects : (groups + stations,) effect of every group, and of every station relative to the first of its part.
    run_deviation : σ; of sensor and run together where the model is fixed.
    sensor_deviation : σ√θ; None where the model is fixed.
    ratio : interval of θ; None where the model is fixed.
    criterion : minus twice the restricted log likelihood; None where the model is fixed.
    notes : weaknesses of the design and the fit, in sentences.
    covariance : (p, p) ndarray of the columns that :meth:`Crossing.kept` names, in the square of the values' unit.
    freedom : degrees of freedom of σ where the model is fixed, of the sensors' variance where it is mixed.
    small : basis of the degrees of freedom; None where they are ``freedom``, whatever the contrast.
    session_deviation : deviation of a group at a station from the sum of both effects; None where it is not fitted.
    scatter : variances where groups scatter differently; None where they are taken as alike.
    """

    model: Model
    design: Crossing
    effects: Array
    run_deviation: float
    sensor_deviation: float | None
    ratio: Interval | None
    criterion: float | None
    notes: tuple[str, ...]
    small: ContrastFreedom | None
    covariance: Array
    freedom: float
    session_deviation: float | None = None
    scatter: Scatter | None = None

    def group_difference(self, first: str, second: str) -> Contrast:
        """Return first − second, adjusted for stations.

        Raises
        ------
        NumericsError
            An unknown or the same group twice, or two that no stations connect.
        """
        self.design.same_part(first, second)
        weights = self._weights()
        weights[self.design.index("group", first)] += 1
        weights[self.design.index("group", second)] -= 1
        return self._contrast(weights, f"{first} − {second}")

    def station_difference(self, first: str, second: str) -> Contrast:
        """Return station ``first`` minus ``second``, adjusted for groups.

        Raises
        ------
        NumericsError
            An unknown or the same station twice, or two that no groups connect.
        """
        places = [self.design.index("station", name) for name in (first, second)]
        first_part, second_part = (int(self.design.station_parts[place]) for place in places)
        if first_part != second_part:
            raise NumericsError(
                f"stations {first} and {second} cannot be compared: no group ran on stations that connect them",
                remedy="measure the same sensors on both",
            )
        weights = self._weights()
        weights[len(self.design.groups) + places[0]] += 1
        weights[len(self.design.groups) + places[1]] -= 1
        return self._contrast(weights, f"station {first} − {second}")

    def _weights(self) -> Array:
        return np.zeros(len(self.effects))

    def _contrast(self, weights: Array, what: str) -> Contrast:
        inner = weights[self.design.independent_columns()]
        if not inner.any() and not weights.any():
            raise NumericsError(f"{what}: it cannot be compared with itself")
        freedom = self.small.freedom(inner) if self.small else self.freedom
        return make_contrast(
            float(weights @ self.effects), sqrt(float(inner @ self.covariance @ inner)), freedom, what
        )


def fit(design: Crossing, values: Array, what: str = "values") -> Fit:
    """Fit the model to one metric.

    Parameters
    ----------
    values : (N,), one per run; leave missing ones out with :meth:`Crossing.only`.
    what : the metric, for messages.

    Raises
    ------
    NumericsError
        Missing values, no variance, or no more sensors than effects to estimate.
    """
    array = sample(values, what)
    if len(array) != len(design.group):
        raise NumericsError(f"{what}: {len(array)} values for {len(design.group)} runs")
    reduced = _reduce(design, array, what)
    reason = _inseparable(reduced.sums)
    if not reason:
        return _fit_mixed(design, reduced, what)
    first = design.first_runs()
    if len(first) < len(array):
        design, reduced = design.select_runs(first), _reduce(design.select_runs(first), array[first], what)
    return _fit_fixed(design, reduced, reason, what)


@dataclass(frozen=True, slots=True, eq=False)
class _Reduced:
    """Response as origin + scale (X start + r), and the sums of X and r; the start affects only rounding."""

    sums: RandomEffectSums
    origin: float
    scale: float
    start: Array

    def effects(self, design: Crossing, inner: Array) -> Array:
        """Return the effects in the response's unit, zeros for left-out stations."""
        all_effects = np.zeros(len(design.groups) + len(design.stations))
        all_effects[design.independent_columns()] = self.scale * (self.start + inner)
        all_effects[: len(design.groups)] += self.origin
        return all_effects


def _reduce(design: Crossing, array: Array, what: str) -> _Reduced:
    origin, deviations = subtract_mean(array)
    scale = float(np.abs(deviations).max())
    if scale <= LEAST_SPREAD * float(np.abs(array).max()):
        raise NumericsError(f"{what}: all {len(array)} values are {array[0]:.6g}: there is no variance")
    matrix = design.columns()
    if matrix.shape[0] == matrix.shape[1]:
        raise _nothing_left(what, len(design.sensors), matrix.shape[1])
    normal, right = (matrix.T @ matrix).toarray(), np.asarray(matrix.T @ (deviations / scale), dtype=np.float64)
    start: Array = linalg.solve(normal, right, assume_a="pos")
    residual = deviations / scale - matrix @ start
    if float(np.abs(residual).max()) * scale <= LEAST_SPREAD * max(float(np.abs(array).max()), scale):
        raise NumericsError(f"{what}: values do not differ within groups and stations: there is no variance")
    return _Reduced(random_effect_sums(matrix, residual, design.sensor), origin, scale, start)


def _nothing_left(what: str, sensors: int, effects: int) -> NumericsError:
    return NumericsError(
        f"{what}: {sensors} sensors are too few to judge {effects} effects of groups and stations",
        remedy="measure more sensors of each group",
    )


def _inseparable(sums: RandomEffectSums) -> str:
    """Say why sensor and run variance cannot be separated; empty otherwise."""
    if sums.runs == sums.total_sensors:
        return "no sensor has more than one run, so variation between sensors and between runs cannot be separated"
    if _repeats(sums) < 1:
        return "the stations' differences use up the repeated runs of sensors: first runs only"
    within_squares = sums.within_rest()
    if within_squares <= sums.runs * LEAST_SPREAD**2 or within_squares <= 1e-12 * float(sums.products(0.0)[-1, -1]):
        return "runs of one sensor do not differ: first runs only"
    return ""


def _fit_mixed(design: Crossing, reduced: _Reduced, what: str) -> Fit:
    sums = reduced.sums
    between_freedom = sums.total_sensors + sums.within_rank() - sums.columns
    if between_freedom < 1:
        raise _nothing_left(what, sums.total_sensors, sums.columns)
    ratio = variance_ratio(sums)
    small = small_sample(sums, ratio.value)
    cross_products = sums.within + sums.products(ratio.value)
    inner = np.asarray(np.linalg.solve(cross_products[:-1, :-1], cross_products[:-1, -1]), dtype=np.float64)
    deviation = reduced.scale * sqrt(ratio.variance)
    return Fit(
        model=Model.MIXED,
        design=design,
        effects=reduced.effects(design, inner),
        run_deviation=deviation,
        sensor_deviation=deviation * sqrt(ratio.value),
        ratio=ratio.interval,
        criterion=ratio.criterion + 2 * (sums.runs - sums.columns) * log(reduced.scale),
        notes=(*_notes(ratio, _repeats(sums)), *_weaknesses(design)),
        small=small,
        covariance=deviation**2 * small.adjusted,
        freedom=float(between_freedom),
    )


def _fit_fixed(design: Crossing, reduced: _Reduced, reason: str, what: str) -> Fit:
    sums = reduced.sums
    cross_products = sums.within + sums.products(0.0)
    freedom = sums.runs - sums.columns
    if freedom < 1:
        raise _nothing_left(what, sums.runs, sums.columns)
    inverse = np.asarray(np.linalg.inv(cross_products[:-1, :-1]), dtype=np.float64)
    variance = float(np.linalg.cholesky(cross_products)[-1, -1]) ** 2 / freedom * reduced.scale**2
    return Fit(
        model=Model.FIXED,
        design=design,
        effects=reduced.effects(design, inverse @ cross_products[:-1, -1]),
        run_deviation=sqrt(variance),
        sensor_deviation=None,
        ratio=None,
        criterion=None,
        notes=(reason, *_weaknesses(design)),
        small=None,
        covariance=variance * inverse,
        freedom=float(freedom),
    )


def _repeats(sums: RandomEffectSums) -> int:
    """Degrees of freedom of repeated runs, less those of stations' differences."""
    return sums.runs - sums.total_sensors - sums.within_rank()


def _notes(ratio: Ratio, repeats: int) -> tuple[str, ...]:
    notes = []
    if repeats < FEWEST_REPEATS:
        notes.append(f"{repeats} repeated runs separate sensors from runs: their variance ratio is poorly known")
    if not ratio.value:
        notes.append("sensors differ no more than runs of one sensor do: their variance is estimated as zero")
    return tuple(notes)


def _weaknesses(design: Crossing) -> tuple[str, ...]:
    """List comparisons that depend more on the model than on the design."""
    notes = []
    for part in design.parts if len(design.parts) > 1 else ():
        notes.append(
            f"{', '.join(part.groups)} on {', '.join(part.stations)}: not compared with groups on other stations, "
            "whose difference cannot be separated from the stations'"
        )
    for index, name in enumerate(design.groups):
        codes = np.unique(design.station[design.group == index])
        part = design.parts[int(design.group_parts[index])]
        if len(codes) == 1 and len(part.stations) > 1:
            notes.append(
                f"{name} ran on {design.stations[codes[0]]} only: its differences from groups on other stations rest "
                "on those that ran on both"
            )
    return tuple(notes)
