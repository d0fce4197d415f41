"""Nested gauge R&R by analysis of variance, all effects random: for parts that only one appraiser can measure.

So it is where a test destroys its part (the sensors of a batch are then the repeated runs of that batch, which counts
as one part), or where parts cannot travel. With p parts of each of o appraisers and r trials of each part,

    MS_appraiser = σ² + r σ²_p + p r σ²_o,    MS_part = σ² + r σ²_p,    MS_trial = σ²

(Montgomery, Design and Analysis of Experiments, section 14.1). There is no interaction: no part meets two appraisers.
Intervals are those of :mod:`cbsr_qa.stats.gauge.anova`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, prefix_kind
from cbsr_qa.stats.gauge.anova import GaugeAnova, MeanSquare, Row, make_row, pivot_interval, sum_interval
from cbsr_qa.stats.gauge.crossed_study import (
    CATEGORY_FACTOR,
    Variance,
    check_tolerance,
    clip_at_zero,
    count_usual_trials,
    on,
    variation,
)
from cbsr_qa.stats.samples import constant, sample, share


@dataclass(frozen=True, slots=True, eq=False)
class NestedStudy:
    """A balanced nested study.

    Parameters
    ----------
    values : (parts of each appraiser, appraisers, trials) ndarray, at least two of each.
    parts : names, appraiser by appraiser.
    stations : names of the appraisers, sorted.
    part, appraiser : nouns for both, for messages.
    """

    values: Array
    parts: tuple[str, ...]
    stations: tuple[str, ...]
    part: str = "sensor"
    appraiser: str = "station"

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of parts of each appraiser, of appraisers and of trials."""
        parts, stations, trials = self.values.shape
        return parts, stations, trials


def uneven_parts(parts: Sequence[str], stations: Sequence[str], part: str, appraiser: str) -> tuple[str, ...]:
    """Describe parts of several appraisers and missing and surplus runs and parts, one sentence each."""
    runs = _count_runs(parts, stations)
    problems = []
    for name in sorted(set(parts)):
        appraisers = sorted(station for other, station in runs if other == name)
        if len(appraisers) > 1:
            problems.append(f"{prefix_kind(part, name)} was run {on(appraiser)} {' and '.join(appraisers)}")
    trials = count_usual_trials(runs.values())
    for (name, station), count in sorted(runs.items()):
        if count != trials:
            has = f"{count} run{'s' * (count != 1)} instead of {trials}"
            problems.append(f"{prefix_kind(part, name)} {on(appraiser)} {station} has {has}")
    numbers = {station: sum(other == station for _, other in runs) for station in sorted(set(stations))}
    usual = count_usual_trials(numbers.values())
    for station, count in numbers.items():
        if count != usual:
            plural = "" if count == 1 else "es" if part.endswith("h") else "s"
            problems.append(f"{prefix_kind(appraiser, station)} has {count} {part}{plural} instead of {usual}")
    return tuple(problems)


def nested_study(
    parts: Sequence[str],
    stations: Sequence[str],
    values: Sequence[float],
    *,
    part: str = "sensor",
    appraiser: str = "station",
) -> NestedStudy:
    """Arrange runs as a nested study.

    Parameters
    ----------
    parts, stations : (N,) names of each run.
    values : (N,) the metric of each run.
    part : "sensor", or "batch" where tests destroy sensors.
    appraiser : "station", or "operator" where people are compared.

    Raises
    ------
    NumericsError
        If values are missing, a part belongs to two appraisers, parts or runs are not equally many, there are fewer
        than two appraisers, parts of each or runs of a part, or repeated runs do not differ at all.
    """
    array = sample(values, "nested gauge study", least=8)
    if not len(parts) == len(stations) == len(array):
        raise NumericsError(
            f"nested gauge study: {len(parts)} parts, {len(stations)} {appraiser}s, {len(array)} values"
        )
    runs = _count_runs(parts, stations)
    if len(runs) > len(set(parts)):
        raise NumericsError(
            f"nested gauge study: {uneven_parts(parts, stations, part, appraiser)[0]}",
            remedy=f"in a nested study every {part} has one {appraiser}; leave out --nested for a crossed study",
        )
    columns = sorted(set(stations))
    names = {station: sorted(name for name, other in runs if other == station) for station in columns}
    sizes = (
        (f"{len(columns)} {appraiser}", len(columns)),
        (
            f"1 {part} of {prefix_kind(appraiser, min(columns, key=lambda s: len(names[s])))}",
            min(map(len, names.values())),
        ),
        (f"1 run of a {part}", count_usual_trials(runs.values())),
    )
    for found, size in sizes:
        if size < 2:
            raise NumericsError(f"nested gauge study: {found} instead of at least 2")
    if problems := uneven_parts(parts, stations, part, appraiser):
        raise NumericsError(
            f"nested gauge study: {problems[0]}", remedy=f"add what is missing, or leave that {part} out"
        )
    readings: dict[str, list[float]] = {name: [] for name in parts}
    for name, value in zip(parts, array.tolist(), strict=True):
        readings[name].append(value)
    if all(constant(np.array(each)) for each in readings.values()):
        raise NumericsError(
            "nested gauge study: repeated runs do not differ at all, so repeatability cannot be estimated",
            remedy="record more digits",
        )
    table = np.array([[readings[name] for name in names[station]] for station in columns]).swapaxes(0, 1)
    ordered = tuple(name for station in columns for name in names[station])
    return NestedStudy(table, ordered, tuple(columns), part, appraiser)


def _count_runs(parts: Sequence[str], stations: Sequence[str]) -> dict[tuple[str, str], int]:
    counts: dict[tuple[str, str], int] = {}
    for cell in zip(parts, stations, strict=True):
        counts[cell] = counts.get(cell, 0) + 1
    return counts


def nested_anova(study: NestedStudy, *, tolerance: float | None = None, confidence: float = 0.95) -> GaugeAnova:
    """Return components, shares and intervals of a nested study.

    ``tolerance``: width of the metric's limits, in its unit.

    Raises
    ------
    NumericsError
        The tolerance is not positive, or the confidence not between 0 and 1.
    """
    check_tolerance(tolerance)
    share(confidence, "confidence")
    p, _, r = study.shape
    rows = _table(study)
    squares = [MeanSquare(row.mean_square, row.degrees_of_freedom) for row in rows]

    def component(*factors: float) -> Variance:
        pairs = zip(squares, factors, strict=True)
        terms = [MeanSquare(square.value, square.freedom, factor) for square, factor in pairs if factor]
        return clip_at_zero(sum(term.factor * term.value for term in terms), sum_interval(terms, confidence))

    repeatability, reproducibility = component(0, 0, 1), component(1 / (p * r), -1 / (p * r), 0)
    gauge, part = component(1 / (p * r), -1 / (p * r), 1), component(0, 1 / r, -1 / r)
    total = component(1 / (p * r), 1 / r - 1 / (p * r), 1 - 1 / r)
    gauge_value = repeatability.value + reproducibility.value
    shares = variation(
        repeatability,
        reproducibility,
        Variance(gauge_value, gauge.estimate, gauge.interval),
        part,
        Variance(gauge_value + part.value, total.estimate, total.interval),
        tolerance=tolerance,
        notes=tuple(
            f"the estimated {name} variance is negative and is set to zero"
            for name, variance in ((study.appraiser, reproducibility), (study.part, part))
            if variance.estimate < 0
        ),
    )

    def gauge_share(drawn: Array) -> Array:
        appraiser, of_parts, trial = drawn
        of_gauge = np.maximum(appraiser - of_parts, 0) / (p * r) + trial
        ratio: Array = of_gauge / (of_gauge + np.maximum(of_parts - trial, 0) / r)
        return ratio

    def categories(drawn: Array) -> Array:
        return CATEGORY_FACTOR * np.sqrt(1 / gauge_share(drawn) - 1)

    return GaugeAnova(
        components=shares.components,
        categories=shares.categories,
        categories_uncut=shares.categories_uncut,
        notes=shares.notes,
        table=rows,
        interaction_pooled=False,
        appraiser_variance=reproducibility.value,
        interaction_variance=None,
        gauge_percent_contribution_interval=pivot_interval(squares, gauge_share, confidence).scale(100.0),
        categories_interval=pivot_interval(squares, categories, confidence),
    )


def _table(study: NestedStudy) -> tuple[Row, Row, Row]:
    values = study.values - study.values.mean()
    p, o, r = study.shape
    parts, stations = values.mean(axis=2), values.mean(axis=(0, 2))
    of_stations = p * r * float(np.sum(stations**2)), o - 1
    of_parts = r * float(np.sum((parts - stations) ** 2)), o * (p - 1)
    of_trials = float(np.sum((values - parts[:, :, None]) ** 2)), p * o * (r - 1)
    return (
        make_row(study.appraiser, *of_stations, of_parts),
        make_row(f"{study.part} ({study.appraiser})", *of_parts, of_trials),
        make_row("repeated runs", *of_trials, None),
    )
