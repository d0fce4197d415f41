"""The difference of two groups in one metric: by the mixed model, beside what a plain test would have claimed.

Of a metric the runs of all compared groups are fitted together: group and station fixed, sensor random
(:mod:`cbsr_qa.stats.mixed_model`). A design that cannot tell a group from a station is not fitted; what can still be
said (the plain difference of means, what a t test claims) is said, under its own name.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import sqrt

import numpy as np

from cbsr_qa.domain import Array, NumericsError
from cbsr_qa.stats import (
    Contrast,
    Crossing,
    Equivalence,
    Interval,
    brunner_munzel,
    hedges,
    sensors_needed,
    sensors_to_show_alike,
    shift,
    welch,
)
from cbsr_qa.stats.mixed_model import Fit, fit
from cbsr_qa.studies.compare.figures import MetricFigures
from cbsr_qa.studies.compare.terms import Terms

REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class Naive:
    """Welch's t test of one figure a sensor, which knows nothing of stations."""

    difference: float
    interval: Interval
    p_value: float
    hedges_g: float | None


@dataclass(frozen=True, slots=True)
class Robust:
    """Hodges and Lehmann's shift and Brunner and Munzel's test, the model's station differences taken out.

    Parameters
    ----------
    interval, p_value : None where the sample is too small, or the groups do not overlap.
    method : of the p value.
    """

    shift: float
    interval: Interval | None
    p_value: float | None
    method: str


@dataclass(frozen=True, slots=True)
class Difference:
    """Group − reference in one metric.

    Parameters
    ----------
    value, interval, p_value : of the model; None where it is refused, ``warnings`` then say why.
    p_adjusted : for all tests of the comparison; None until it is.
    effect, effect_interval : value over the deviation of single runs of different sensors, taken as known.
    equivalence : of this test alone; None where no margin was stated.
    equivalence_p : its p value adjusted for all such tests of the comparison; None until it is.
    deviation : √(sensor² + run²) of the model, in the metric's unit.
    detect, needed : a difference, and how many sensors each of two groups on one station needs to find it with 80 %,
        by one test of the comparison's level; None where none was asked for, or 10⁹ do not do.
    needed_alike : the same for showing two groups alike within the margin that do not differ.
    taken_out : stations (batches, where stations are compared) whose differences the model takes out; one is none.
    model : what was fitted, or :data:`REFUSED`.
    """

    group: str
    reference: str
    model: str
    value: float | None = None
    interval: Interval | None = None
    p_value: float | None = None
    p_adjusted: float | None = None
    effect: float | None = None
    effect_interval: Interval | None = None
    equivalence: Equivalence | None = None
    equivalence_p: float | None = None
    deviation: float | None = None
    detect: float | None = None
    needed: int | None = None
    needed_alike: int | None = None
    taken_out: tuple[str, ...] = ()
    naive: Naive | None = None
    robust: Robust | None = None
    warnings: tuple[str, ...] = field(default=())


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """The model of one metric, or why there is none.

    Parameters
    ----------
    of_stations : whether the compared groups are the model's stations.
    """

    fit: Fit | None
    why: str
    of_stations: bool

    def difference(self, group: str, reference: str) -> Contrast:
        """Return group − reference. NumericsError where the design cannot tell it."""
        if self.fit is None:
            raise NumericsError(self.why)
        of = self.fit.station_difference if self.of_stations else self.fit.group_difference
        return of(group, reference)

    def station_effect(self, station: str) -> float:
        """Return what a station reads above the first of its connected part."""
        assert self.fit is not None
        design = self.fit.design
        if station not in design.stations:
            return 0.0
        return float(self.fit.effects[len(design.groups) + design.index("station", station)])


def fitted(design: Crossing, values: Array, what: str, *, of_stations: bool) -> Fitted:
    """Fit the model to the runs that have a value.

    Parameters
    ----------
    design : of N runs.
    values : (N,) NaN where missing.
    """
    known = ~np.isnan(values)
    if not known.any():
        return Fitted(None, "nothing was measured", of_stations)
    try:
        return Fitted(fit(design if known.all() else design.only(known), values[known], what), "", of_stations)
    except NumericsError as error:
        return Fitted(None, str(error).replace("\n", "; "), of_stations)


def difference(
    model: Fitted,
    figures: MetricFigures,
    names: tuple[str, str],
    values: tuple[Array, Array],
    stations: tuple[Sequence[str], Sequence[str]],
    terms: Terms,
) -> Difference:
    """Compare two groups in one metric.

    Parameters
    ----------
    names : group and reference.
    values : one figure a sensor of each, of the run that decides.
    stations : of those runs.
    """
    naive = _naive(values, names, terms)
    try:
        found = model.difference(*names)
    except NumericsError as error:
        why = str(error).replace("\n", "; ")
        return Difference(*names, REFUSED, naive=naive, robust=None, warnings=(why,))
    assert model.fit is not None
    interval, deviation = found.interval(terms.confidence), _deviation(model.fit)
    detect, margin = (stated.get(figures.key.name) for stated in (terms.detect, terms.margins))
    return Difference(
        *names,
        str(model.fit.model),
        value=found.value,
        interval=interval,
        p_value=found.p_value(),
        effect=found.value / deviation,
        effect_interval=interval.scaled(1 / deviation),
        equivalence=None if margin is None else found.equivalence(margin, level=terms.level),
        deviation=deviation,
        detect=detect,
        needed=_needed(sensors_needed, detect, deviation, terms),
        needed_alike=_needed(sensors_to_show_alike, margin, deviation, terms),
        taken_out=model.fit.design.groups if model.of_stations else model.fit.design.stations,
        naive=naive,
        robust=_robust(model, names, values, stations, terms),
    )


def _deviation(found: Fit) -> float:
    return sqrt(found.run_deviation**2 + (found.sensor_deviation or 0.0) ** 2)


def _needed(count: Callable[..., int], size: float | None, deviation: float, terms: Terms) -> int | None:
    if size is None:
        return None
    try:
        return count(size / deviation, wanted=terms.power, level=terms.level)
    except NumericsError:
        return None


def _naive(values: tuple[Array, Array], names: tuple[str, str], terms: Terms) -> Naive | None:
    try:
        found = welch(*values, names=names)
        size = hedges(*values, confidence=terms.confidence, names=names).value
    except NumericsError:
        return None
    return Naive(found.value, found.interval(terms.confidence), found.p_value(), size)


def _robust(
    model: Fitted,
    names: tuple[str, str],
    values: tuple[Array, Array],
    stations: tuple[Sequence[str], Sequence[str]],
    terms: Terms,
) -> Robust | None:
    level: tuple[Array, Array] = values
    if not model.of_stations:
        effects = {name: model.station_effect(name) for name in {*stations[0], *stations[1]}}
        level = (_without(values[0], stations[0], effects), _without(values[1], stations[1], effects))
    try:
        moved = shift(*level, confidence=terms.confidence, names=names)
    except NumericsError:
        return None
    try:
        return Robust(moved.value, moved.interval, brunner_munzel(*level, names=names).p_value, "Brunner–Munzel")
    except NumericsError:  # groups that do not overlap, or of one sensor
        return Robust(moved.value, moved.interval, moved.p_value, "Mann–Whitney")


def _without(values: Array, stations: Sequence[str], effects: dict[str, float]) -> Array:
    level: Array = values - np.array([effects[station] for station in stations])
    return level
