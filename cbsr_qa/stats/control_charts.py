"""Control charts: individuals and moving range, means and ranges, EWMA, CUSUM.

Limits come from a reference period (phase I), or from known values; later points (phase II) are judged by them. EWMA
and CUSUM restart where phase II begins. Sources: NIST/SEMATECH e-Handbook 6.3.2; Montgomery, Introduction to
Statistical Quality Control, chapters 6 and 9.

    individuals          x̄ ± 3 MR̄/d₂(2);   moving range up to MR̄ (1 + 3 d₃/d₂)
    means of n           x̿ ± 3 R̄/(d₂ √n);  ranges R̄ (1 ± 3 d₃/d₂), not below 0
    EWMA                 z_i = λ x_i + (1 − λ) z_(i−1),  x̄ ± L σ √(λ/(2 − λ) (1 − (1 − λ)^(2i)))
    CUSUM                C⁺_i = max(0, C⁺_(i−1) + x_i − x̄ − k σ), and C⁻ likewise below, up to h σ
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import accumulate
from math import sqrt

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.nelson import ALL_RULES, Rule, d2_d3, nelson
from cbsr_qa.stats.samples import constant, sample, subtract_mean

#: Name of the moving-range signal; Nelson's tests do not apply to such charts.
OUTSIDE = "beyond the limit"
#: Prefix of the names of both cumulative sums.
SUM = "CUSUM"


class Phase(StrEnum):
    """Whether a point belongs to the reference period or is judged by it."""

    REFERENCE = "reference (phase I)"
    MONITORED = "monitored (phase II)"


@dataclass(frozen=True, slots=True)
class Standard:
    """Known mean and deviation of single values, in place of a reference period."""

    mean: float
    deviation: float


#: Number of points (subgroups) at the start that form the reference period, None for all; or known values.
Reference = int | Standard | None


@dataclass(frozen=True, slots=True)
class Signal:
    """A signal: the rule and the point, counted from 0."""

    rule: str
    index: int
    phase: Phase


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """Points with their limits, all (n,) ndarrays, in the unit of the values.

    Parameters
    ----------
    centre : centre line.
    deviation : σ of single values that the limits follow from.
    reference : number of points in phase I; 0 for known values.
    signals : signals in the order of points.
    """

    name: str
    points: Array
    centre: float
    lower: Array
    upper: Array
    deviation: float
    reference: int
    signals: tuple[Signal, ...]

    @property
    def in_control(self) -> bool:
        """Whether no point of phase II gives a signal (of all points, if all are reference)."""
        return not (self.signals_in_phase(Phase.MONITORED) if self.reference < len(self.points) else self.signals)

    def signals_in_phase(self, phase: Phase) -> tuple[Signal, ...]:
        """Return the signals of one phase; those of phase I cast doubt on the limits themselves."""
        return tuple(signal for signal in self.signals if signal.phase is phase)


def individuals(
    values: Iterable[float],
    *,
    reference: Reference = None,
    rules: Collection[Rule] = ALL_RULES,
    what: str = "individuals",
) -> Chart:
    """Return the chart of single values; see :func:`moving_range` for its companion.

    Parameters
    ----------
    values : (n,) values in their order; σ is the reference's mean moving range over d₂.
    rules : Nelson's tests to apply.

    Raises
    ------
    NumericsError
        Missing values, fewer than two in the reference period, or equal values throughout it.
    """
    array = sample(values, what)
    standard, count = _standard(array, reference, what)
    return _apply_rules("individuals", array, standard.mean, standard.deviation, standard.deviation, count, rules)


def moving_range(values: Iterable[float], *, reference: Reference = None) -> Chart:
    """Return the chart of |x_i − x_(i−1)|; its point 0 belongs to values 0 and 1. See :func:`individuals`."""
    array = sample(values, "moving range", least=2)
    standard, count = _standard(array, reference, "moving range")
    return _ranges("moving range", np.abs(np.diff(array)), 2, standard.deviation, max(count - 1, 0))


def means_and_ranges(
    subgroups: Sequence[Sequence[float]],
    *,
    reference: Reference = None,
    rules: Collection[Rule] = ALL_RULES,
) -> tuple[Chart, Chart]:
    """Return the charts of means and ranges of subgroups.

    Parameters
    ----------
    subgroups : (k, n), all of the same size n ≥ 2; σ is the reference's mean range over d₂(n).

    Raises
    ------
    NumericsError
        Missing values, subgroups of different sizes or of one value, or a reference without range.
    """
    label, sizes = "subgroups", sorted({len(group) for group in subgroups})
    if len(sizes) != 1:
        raise NumericsError(
            f"{label}: sizes {', '.join(map(str, sizes)) or 'none'}; a chart of ranges needs one size"
        )
    if sizes[0] < 2:
        raise NumericsError(f"{label}: subgroups of one value have no range", remedy="use a chart of individuals")
    table = np.array([sample(group, f"{label}, number {index}") for index, group in enumerate(subgroups)])
    d2, _ = d2_d3(sizes[0])
    means, ranges = table.mean(axis=1), np.ptp(table, axis=1)
    if isinstance(reference, Standard):
        standard, count = reference, 0
    else:
        count = _reference_count(reference, len(table), 1, label)
        standard = Standard(subtract_mean(means[:count])[0], float(ranges[:count].mean()) / d2)
    _check_deviation(standard.deviation, label)
    error = standard.deviation / sqrt(sizes[0])
    chart = _apply_rules("means", means, standard.mean, error, standard.deviation, count, rules)
    return chart, _ranges("ranges", ranges, sizes[0], standard.deviation, count)


def ewma(values: Iterable[float], *, weight: float = 0.2, width: float = 3.0, reference: Reference = None) -> Chart:
    """Return the exponentially weighted moving average, which detects small lasting shifts.

    ``weight``: λ, above 0 and at most 1; ``width``: L, in standard deviations of the average.

    Raises
    ------
    NumericsError
        A weight or width out of range, or as for :func:`individuals`.
    """
    if not (0 < weight <= 1 and width > 0):
        raise NumericsError(f"EWMA: weight {weight:g} and width {width:g}; allowed are 0 < weight ≤ 1 and width > 0")
    array = sample(values, "EWMA")
    standard, count = _standard(array, reference, "EWMA")
    points, age = np.empty(len(array)), np.empty(len(array))
    for phase in _phases(len(array), count):
        steps = accumulate(array[phase], lambda z, x: (1 - weight) * z + weight * x, initial=standard.mean)
        points[phase] = list(steps)[1:]
        age[phase] = np.arange(1, len(array[phase]) + 1)
    half_width = width * standard.deviation * np.sqrt(weight / (2 - weight) * (1 - (1 - weight) ** (2 * age)))
    return _apply_limits("EWMA", points, standard, standard.mean - half_width, standard.mean + half_width, count)


def cusum(
    values: Iterable[float],
    *,
    slack: float = 0.5,
    threshold: float = 5.0,
    reference: Reference = None,
) -> tuple[Chart, Chart]:
    """Return the tabular cumulative sums above and below the mean, the lower one drawn downwards.

    ``slack``: k, half the shift to detect; ``threshold``: h; both in deviations.

    Raises
    ------
    NumericsError
        A slack or threshold out of range, or as for :func:`individuals`.
    """
    if not (slack >= 0 and threshold > 0):
        raise NumericsError(f"{SUM}: slack {slack:g}, threshold {threshold:g}; allowed: slack ≥ 0, threshold > 0")
    array = sample(values, SUM)
    standard, count = _standard(array, reference, SUM)
    sums_above, sums_below = (
        _sums(sign * (array - standard.mean), slack * standard.deviation, count) for sign in (1, -1)
    )
    limit, zero = np.full(len(array), threshold * standard.deviation), np.zeros(len(array))
    centre = Standard(0.0, standard.deviation)
    upper = _apply_limits(f"{SUM} above", sums_above, centre, zero, limit, count)
    return upper, _apply_limits(f"{SUM} below", -sums_below, centre, -limit, zero, count)


def _sums(away: Array, slack: float, reference: int) -> Array:
    sums = np.empty(len(away))
    for part in _phases(len(away), reference):
        steps = accumulate(away[part], lambda total, step: max(0.0, total + step - slack), initial=0.0)
        sums[part] = list(steps)[1:]
    return sums


def _phases(count: int, reference: int) -> tuple[slice, slice]:
    return slice(0, reference), slice(reference, count)


def _standard(array: Array, reference: Reference, what: str) -> tuple[Standard, int]:
    """Mean and short-term deviation of the reference period, and its length."""
    if isinstance(reference, Standard):
        _check_deviation(reference.deviation, what)
        return reference, 0
    count = _reference_count(reference, len(array), 2, what)
    period = array[:count]
    if constant(period):
        raise NumericsError(f"{what}: all {count} values of the reference period are {period[0]:.6g}: no spread")
    return Standard(subtract_mean(period)[0], float(np.abs(np.diff(period)).mean()) / d2_d3(2)[0]), count


def _reference_count(reference: int | None, count: int, least: int, what: str) -> int:
    period = count if reference is None else reference
    if not least <= period <= count:
        raise NumericsError(f"{what}: reference period is {period} points; allowed are {least} to {count}")
    return period


def _check_deviation(deviation: float, what: str) -> None:
    if not 0 < deviation < float("inf"):
        raise NumericsError(f"{what}: deviation is {deviation:g}; limits need a positive one")


def _apply_rules(
    name: str, points: Array, centre: float, error: float, deviation: float, count: int, rules: Collection[Rule]
) -> Chart:
    flags_by_rule = nelson((points - centre) / error, rules)
    pairs = [(int(index), rule) for rule, flags in flags_by_rule.items() for index in np.flatnonzero(flags)]
    signals = tuple(Signal(rule.value, index, _phase(index, count)) for index, rule in sorted(pairs))
    half_width = np.full(len(points), 3 * error)
    return Chart(name, points, centre, centre - half_width, centre + half_width, deviation, count, signals)


def _ranges(name: str, ranges: Array, size: int, deviation: float, count: int) -> Chart:
    d2, d3 = d2_d3(size)
    lower = np.full(len(ranges), max(d2 - 3 * d3, 0.0) * deviation)
    upper = np.full(len(ranges), (d2 + 3 * d3) * deviation)
    return _apply_limits(name, ranges, Standard(d2 * deviation, deviation), lower, upper, count)


def _apply_limits(name: str, points: Array, standard: Standard, lower: Array, upper: Array, count: int) -> Chart:
    outside = np.flatnonzero((points < lower) | (points > upper))
    signals = tuple(Signal(OUTSIDE, int(index), _phase(int(index), count)) for index in outside)
    return Chart(name, points, standard.mean, lower, upper, standard.deviation, count, signals)


def _phase(index: int, reference: int) -> Phase:
    return Phase.REFERENCE if index < reference else Phase.MONITORED
