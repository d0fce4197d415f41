"""Differences of groups and of stations in one metric, by the mixed model and, for comparison, by plain tests."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Final, TypeVar

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.fleet import FleetTable
from cbsr_qa.stats.crossings import IntArray
from cbsr_qa.stats.difference import Contrast, hedges, holm, welch
from cbsr_qa.stats.power_analysis import sensors_needed, sensors_to_show_alike
from cbsr_qa.stats.robust import brunner_munzel
from cbsr_qa.stats.samples import Interval
from cbsr_qa.stats.stratified import shift_within
from cbsr_qa.studies.compare.groups import Design
from cbsr_qa.studies.compare.models import Fitted, fit_model, include_sessions
from cbsr_qa.studies.compare.terms import Terms
from cbsr_qa.studies.compare.values import MetricValues, OfMetric

#: Model name of groups that cannot be separated.
REFUSED: Final = "refused"
#: Largest number of locations of a grid; a phase with more has random loads.
_MOST_PLACES: Final = 25
_WITH_BATCH: Final = "group and each station's batches"


@dataclass(frozen=True, slots=True)
class Naive:
    """Welch's t test of one value per sensor, which ignores stations."""

    difference: float
    low: float
    high: float
    p: float
    hedges_g: float | None


@dataclass(frozen=True, slots=True)
class Robust:
    """Hodges and Lehmann's shift, from sensors of both groups at the same station, with van Elteren's test.

    Where they share a single station, the test is Brunner and Munzel's. The interval is None for samples too small.
    """

    shift: float
    interval: Interval | None
    p: float | None
    method: str


@dataclass(frozen=True, slots=True)
class PlaceDifference:
    """Group − reference at one place; p is adjusted for the places of its metric."""

    location: str
    x_mm: float | None
    y_mm: float | None
    difference: float
    low: float
    high: float
    p: float


@dataclass(frozen=True, slots=True)
class Estimated(OfMetric):
    """A difference from a reference by the model, in ``unit``; None if refused, for the reason in the first warning.

    Parameters
    ----------
    p, p_unadjusted : adjusted for all tests of the comparison (None until it is), and of this test alone.
    """

    reference: str | None
    difference: float | None = None
    low: float | None = None
    high: float | None = None
    p: float | None = None
    p_unadjusted: float | None = None
    warnings: tuple[str, ...] = ()

    @property
    def known(self) -> bool:
        """Whether the model could estimate it."""
        return self.difference is not None


@dataclass(frozen=True, slots=True)
class StationDifference(Estimated):
    """Difference of a station's readings from the reference, adjusted for groups."""

    station: str = ""


@dataclass(frozen=True, slots=True)
class Difference(Estimated):
    """Group − reference in one metric.

    Parameters
    ----------
    group : None if the metric is not compared between groups.
    model : the fitted one, :data:`REFUSED`, or ``"none"``.
    deviation : √(sensor² + run²) of the model, in the metric's unit; unit of the effect size, taken as known.
    equivalent : whether two one-sided tests show the difference to be within ``margin``, by ``equivalence_p``, which
        is adjusted for all such tests of the comparison.
    sensors_to_show_alike : sensors of each of two groups on one station, to show equivalence within the margin with
        80 % power if they do not differ, by one test at the comparison's level; None if 10⁹ do not suffice.
    sensors_needed : number of sensors of each group to detect the difference ``detect``, likewise.
    """

    group: str | None = None
    model: str = "none"
    deviation: float | None = None
    effect_size: float | None = None
    effect_size_interval: Interval | None = None
    margin: float | None = None
    equivalent: bool | None = None
    equivalence_interval: Interval | None = None
    equivalence_p: float | None = None
    equivalence_p_unadjusted: float | None = None
    sensors_to_show_alike: int | None = None
    detect: float | None = None
    sensors_needed: int | None = None
    naive: Naive | None = None
    robust: Robust | None = None
    places: tuple[PlaceDifference, ...] = ()


_Estimate = TypeVar("_Estimate", Difference, StationDifference)


def _fill_contrast(estimated: _Estimate, contrast: Contrast, terms: Terms) -> _Estimate:
    """Fill in an estimate's fields before adjustment."""
    interval = contrast.interval(terms.confidence)
    return replace(
        estimated, difference=contrast.value, low=interval.low, high=interval.high, p_unadjusted=contrast.p_value()
    )


def difference(
    model: Fitted, metric: MetricValues, known: Mapping[str, IntArray], names: tuple[str, str], design: Design
) -> Difference:
    """Compare two groups, group and reference, in one metric."""
    terms = design.terms
    values = metric.mean[known[names[0]]], metric.mean[known[names[1]]]
    naive = _naive(values, names, terms)
    refused = Difference(*metric.identity, names[1], group=names[0], model=REFUSED, naive=naive)
    try:
        contrast = model.difference(*names)
    except NumericsError as error:
        why = "" if model.fit is None else design.untold(model.fit.design, *names)
        return replace(refused, warnings=(why or _to_one_line(error),))
    assert model.fit is not None
    estimated = _fill_contrast(refused, contrast, terms)
    deviation = sqrt(model.fit.run_deviation**2 + (model.fit.sensor_deviation or 0.0) ** 2)
    detect, margin = (stated.get(metric.key.name) for stated in (terms.detect, terms.margins))
    equivalence_test = None if margin is None else contrast.equivalence(margin, level=terms.level)
    kind = str(model.fit.model)
    return replace(
        estimated,
        model=kind.replace("group and station", _WITH_BATCH) if design.levels else kind,
        deviation=deviation,
        effect_size=contrast.value / deviation,
        effect_size_interval=contrast.interval(terms.confidence).scale(1 / deviation),
        margin=margin,
        equivalence_interval=None if equivalence_test is None else equivalence_test.interval,
        equivalence_p_unadjusted=None if equivalence_test is None else equivalence_test.p_value,
        sensors_to_show_alike=_count_sensors(sensors_to_show_alike, margin, deviation, terms),
        detect=detect,
        sensors_needed=_count_sensors(sensors_needed, detect, deviation, terms),
        robust=_robust(metric, known, names, design),
    )


def _to_one_line(error: NumericsError) -> str:
    return str(error).replace("\n", "; ")


def _count_sensors(count: Callable[..., int], size: float | None, deviation: float, terms: Terms) -> int | None:
    if size is None:
        return None
    try:
        return count(size / deviation, wanted=terms.power, level=terms.level)
    except NumericsError:
        return None


def _naive(values: tuple[Array, Array], names: tuple[str, str], terms: Terms) -> Naive | None:
    try:
        contrast = welch(*values, names=names)
        size = hedges(*values, confidence=terms.confidence, names=names).value
    except NumericsError:
        return None
    interval = contrast.interval(terms.confidence)
    return Naive(contrast.value, interval.low, interval.high, contrast.p_value(), size)


def _robust(
    metric: MetricValues, known: Mapping[str, IntArray], names: tuple[str, str], design: Design
) -> Robust | None:
    """Compare the deciding runs of two groups within stations, or within batches where stations are the groups."""
    made = design.crossing
    levels = made.group if design.of_stations else made.station
    level_of_run = [levels[np.searchsorted(design.rows, known[name])] for name in names]
    strata = [
        (
            metric.mean[known[names[0]][level_of_run[0] == level]],
            metric.mean[known[names[1]][level_of_run[1] == level]],
        )
        for level in sorted({*level_of_run[0].tolist()} & {*level_of_run[1].tolist()})
    ]
    try:
        shift = shift_within(strata, confidence=design.terms.confidence, names=names)
    except NumericsError:
        return None
    if len(strata) > 1:
        return Robust(shift.value, shift.interval, shift.p_value, f"van Elteren, {len(strata)} strata")
    try:
        return Robust(shift.value, shift.interval, brunner_munzel(*strata[0], names=names).p_value, "Brunner–Munzel")
    except NumericsError:  # groups that do not overlap, or of a single sensor
        return Robust(shift.value, shift.interval, shift.p_value, "Mann–Whitney")


def compare_places(
    metric: MetricValues, table: FleetTable, pairs: Sequence[tuple[str, str]], design: Design
) -> dict[str, tuple[PlaceDifference, ...]]:
    """Differences of groups by place, if the places form a grid and the metric matters."""
    is_wanted = metric.limited or metric.key.name in design.terms.names
    if not pairs or not is_wanted or not 3 <= len(metric.at) <= _MOST_PLACES:
        return {}
    by_location = [
        fit_model(
            design.crossing, values[design.rows], f"{metric.key.label} at {location}", of_stations=design.of_stations
        )
        for location, values in metric.at.items()
    ]
    models = dict(zip(metric.at, include_sessions(by_location), strict=True))
    return {pair[0]: _places_of(models, pair, table, design.terms) for pair in pairs}


def _places_of(
    models: Mapping[str, Fitted], pair: tuple[str, str], table: FleetTable, terms: Terms
) -> tuple[PlaceDifference, ...]:
    places = []
    for location, model in models.items():
        try:
            contrast = model.difference(*pair)
        except NumericsError:
            continue
        interval = contrast.interval(terms.confidence)
        x_mm, y_mm = table.places_mm.get(location, (None, None))
        places.append(
            PlaceDifference(location, x_mm, y_mm, contrast.value, interval.low, interval.high, contrast.p_value())
        )
    adjusted = holm([place.p for place in places]).tolist()
    return tuple(replace(place, p=p) for place, p in zip(places, adjusted, strict=True))


def stations_above(model: Fitted, metric: MetricValues, design: Design) -> Iterator[StationDifference]:
    """Compare stations with the one with most runs, adjusted for differences of groups."""
    for name in design.stations[1:]:
        unestimated = StationDifference(*metric.identity, design.stations[0], station=name)
        try:
            if model.fit is None:
                raise NumericsError(model.why)
            yield _fill_contrast(unestimated, model.fit.station_difference(name, design.stations[0]), design.terms)
        except NumericsError as error:
            yield replace(unestimated, warnings=(_to_one_line(error),))
