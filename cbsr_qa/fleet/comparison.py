"""A whole comparison: groups, every metric of them, stations, and what the design leaves open."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from difflib import get_close_matches
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.fleet import FleetRun, FleetTable
from cbsr_qa.fleet.clocks import clock_warnings
from cbsr_qa.fleet.describe import Described, Group, described, groups_of
from cbsr_qa.fleet.differences import Difference, Fitted, difference, fitted
from cbsr_qa.fleet.figures import MetricFigures, figures_of, named
from cbsr_qa.fleet.groups import Grouping, grouped, software_words
from cbsr_qa.fleet.terms import Adjustment, By, Terms
from cbsr_qa.report.numbers import plural
from cbsr_qa.stats.crossing import Crossing, IntArray, crossing
from cbsr_qa.stats.multiplicity import benjamini_hochberg, holm
from cbsr_qa.stats.worst_value import FloatArray

#: What all places of a grid share is how the disc was seated and where the axes are: the station's, not the sensor's.
OF_THE_STATION: Final = ("registration_shift", "registration_rotation", "registration_scale")
_SHARES_PLACES: Final = {"centre_of_mass_error": "registered_centre_of_mass_error"}
_NO_BATCH: Final = "batch not stated"
#: Locations beyond which a phase's places are random loads rather than a grid.
_MOST_PLACES: Final = 25


@dataclass(frozen=True, slots=True)
class PlaceDifference:
    """Group − reference at one place; p is adjusted for the places of its metric."""

    location: str
    x_mm: float | None
    y_mm: float | None
    value: float
    low: float
    high: float
    p_adjusted: float


@dataclass(frozen=True, slots=True, eq=False)
class MetricComparison:
    """One metric.

    Parameters
    ----------
    described : one of each group.
    differences : of each group but the reference, against it; empty where the metric is the station's alone.
    stations : of each station but the first, against it; empty where there is one, or stations are the groups.
    maps : group → differences by place.
    samples : (group, station, figures of sensors), for plots.
    notes : weaknesses of design and fit, and what was left out.
    """

    figures: MetricFigures
    described: tuple[Described, ...]
    differences: tuple[Difference, ...]
    stations: tuple[Difference, ...]
    maps: Mapping[str, tuple[PlaceDifference, ...]]
    samples: tuple[tuple[str, str, FloatArray], ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """What was compared, and what came of it."""

    terms: Terms
    groups: tuple[Group, ...]
    metrics: tuple[MetricComparison, ...]
    warnings: tuple[str, ...]
    simulated: tuple[str, ...]
    recipes: tuple[str, ...]

    @property
    def reference(self) -> str:
        """The group the others are compared with."""
        return self.groups[0].name

    @property
    def compared(self) -> bool:
        """Whether any difference could be told."""
        return any(one.value is not None for metric in self.metrics for one in metric.differences)


def compare(table: FleetTable, terms: Terms, now: datetime) -> Comparison:
    """Compare groups of runs in every metric.

    Parameters
    ----------
    table : runs and their values.
    now : by the computer's clock, for times that are still to come.

    Raises
    ------
    RefusedError
        If no run counts, or a group or metric that was named is not there (with the nearest name).
    """
    grouping = grouped(table.runs, terms)
    every = list(figures_of(table, grouping.used))
    chosen = _wanted(every, terms)
    design = _design(table.runs, grouping, terms.by)
    deciding = grouping.deciding(table.runs, terms.policy)
    metrics = [_metric(figures, table, grouping, deciding, design, terms) for figures in chosen]
    members = [run for run, used in zip(table.runs, grouping.used, strict=True) if used]
    return Comparison(
        terms=terms,
        groups=tuple(groups_of(table.runs, grouping, every, terms)),
        metrics=tuple(_adjusted(metrics, terms.adjustment)),
        warnings=tuple(_warnings(members, grouping, terms, now)),
        simulated=tuple(sorted({said for simulated in {run.simulated for run in members} for said in simulated})),
        recipes=tuple(sorted({run.recipe for run in members})),
    )


def _wanted(every: Sequence[MetricFigures], terms: Terms) -> list[MetricFigures]:
    known = sorted({figures.key.name for figures in every})
    for name in (*terms.names, *terms.margins, *terms.detect):
        if name not in known:
            raise unknown_metric(name, known)
    return [figures for figures in every if not terms.names or figures.key.name in terms.names]


def unknown_metric(name: str, known: Sequence[str]) -> RefusedError:
    """Refuse a metric nobody measured, with the nearest name."""
    near = get_close_matches(name, known, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return RefusedError(
        f"no run that counts measured {name[:64]!r}", remedy=f"{hint}measured: {', '.join(known) or 'nothing'}"
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Design:
    """The crossing of the runs that count, which they are, and the stations to compare, that with most runs first."""

    crossing: Crossing
    rows: IntArray
    of_stations: bool
    stations: tuple[str, ...]


def _design(runs: Sequence[FleetRun], grouping: Grouping, by: By) -> _Design:
    rows, of_stations = np.flatnonzero(grouping.used), by is By.STATION
    members = [runs[row] for row in rows.tolist()]
    # Where stations are compared, what must not be taken for one is the batch.
    batches, labels = [run.batch or _NO_BATCH for run in members], [grouping.labels[row] for row in rows.tolist()]
    made = crossing(
        batches if of_stations else labels, [run.station for run in members], [run.serial for run in members]
    )
    return _Design(made, rows, of_stations, () if of_stations else _by_runs(made))


def _by_runs(made: Crossing) -> tuple[str, ...]:
    """Stations, that with most runs first; none where there is nothing to compare."""
    if len(made.stations) < 2:
        return ()
    return tuple(made.stations[index] for index in np.argsort(-np.bincount(made.station), kind="stable"))


def _metric(
    figures: MetricFigures,
    table: FleetTable,
    grouping: Grouping,
    deciding: Mapping[str, IntArray],
    design: _Design,
    terms: Terms,
) -> MetricComparison:
    label, runs = figures.key.label, table.runs
    model = fitted(design.crossing, figures.mean[design.rows], label, of_stations=design.of_stations)
    of_station = figures.key.name in OF_THE_STATION and not design.of_stations and len(design.stations) > 1
    known = {name: indices[~np.isnan(figures.mean[indices])] for name, indices in deciding.items()}
    differences = [
        _between(model, figures, runs, known, (name, grouping.reference), terms)
        for name in grouping.names[1:]
        if not of_station
    ]
    return MetricComparison(
        figures=figures,
        described=tuple(described(figures, runs, name, known[name], terms) for name in grouping.names),
        differences=tuple(differences),
        stations=tuple(_stations(model, figures, design.stations, terms)),
        maps={} if of_station else _maps(figures, table, grouping, design, terms),
        samples=_samples(figures, runs, known),
        notes=_notes(model, figures, table, of_station=of_station),
    )


def _between(
    model: Fitted,
    figures: MetricFigures,
    runs: Sequence[FleetRun],
    known: Mapping[str, IntArray],
    names: tuple[str, str],
    terms: Terms,
) -> Difference:
    first, second = (known[name] for name in names)
    values = figures.mean[first], figures.mean[second]
    at = [runs[index].station for index in first.tolist()], [runs[index].station for index in second.tolist()]
    return difference(model, figures, names, values, at, terms)


def _stations(
    model: Fitted, figures: MetricFigures, stations: tuple[str, ...], terms: Terms
) -> "Sequence[Difference]":
    """What stations read above the one with most runs, the groups' differences taken out."""
    found = []
    for name in stations[1:]:
        names = name, stations[0]
        try:
            if model.fit is None:
                raise NumericsError(model.why)
            contrast = model.fit.station_difference(*names)
        except NumericsError as error:
            found.append(Difference(*names, "refused", warnings=(str(error).replace("\n", "; "),)))
            continue
        interval = contrast.interval(terms.confidence)
        found.append(Difference(*names, str(model.fit.model), contrast.value, interval, contrast.p_value()))
    return found


def _maps(
    figures: MetricFigures, table: FleetTable, grouping: Grouping, design: _Design, terms: Terms
) -> dict[str, tuple[PlaceDifference, ...]]:
    """Differences by place, where there are as many places as a grid has, and the places are known or limited."""
    wanted = figures.limited or figures.key.name in terms.names
    if not wanted or not 3 <= len(figures.at) <= _MOST_PLACES:
        return {}
    models = {
        location: fitted(
            design.crossing, values[design.rows], f"{figures.key.label} at {location}", of_stations=design.of_stations
        )
        for location, values in figures.at.items()
    }
    found = {}
    for name in grouping.names[1:]:
        places = []
        for location, model in models.items():
            try:
                contrast = model.difference(name, grouping.reference)
            except NumericsError:
                continue
            interval = contrast.interval(terms.confidence)
            x_mm, y_mm = table.places_mm.get(location, (None, None))
            places.append(
                PlaceDifference(location, x_mm, y_mm, contrast.value, interval.low, interval.high, contrast.p_value())
            )
        adjusted = holm([place.p_adjusted for place in places])
        if places:
            found[name] = tuple(
                replace(place, p_adjusted=float(p)) for place, p in zip(places, adjusted, strict=True)
            )
    return found


def _samples(
    figures: MetricFigures, runs: Sequence[FleetRun], known: Mapping[str, IntArray]
) -> tuple[tuple[str, str, FloatArray], ...]:
    found = []
    for name, indices in known.items():
        at: dict[str, list[int]] = {}
        for index in indices.tolist():
            at.setdefault(runs[index].station, []).append(index)
        found += [(name, station, figures.mean[members]) for station, members in sorted(at.items())]
    return tuple(found)


def _notes(model: Fitted, figures: MetricFigures, table: FleetTable, *, of_station: bool) -> tuple[str, ...]:
    notes = list(figures.warnings)
    notes += model.fit.notes if model.fit else ()
    if of_station:
        notes.append("what all places share counts against the station: stations are compared in it, groups are not")
    without = _SHARES_PLACES.get(figures.key.name)
    if without is not None:
        measured = any(kind.key.name == without for kind in table.kinds)
        also = f"; {without} is without" if measured else ""
        notes.append(f"it holds what all places share, which is the station's{also}")
    return tuple(notes)


def _adjusted(metrics: Sequence[MetricComparison], adjustment: Adjustment) -> list[MetricComparison]:
    """Adjust p values: those of groups for all of groups, those of stations for all of stations."""
    groups = iter(_adjust([one.p_value for metric in metrics for one in metric.differences], adjustment))
    stations = iter(_adjust([one.p_value for metric in metrics for one in metric.stations], adjustment))
    return [
        replace(
            metric,
            differences=tuple(replace(one, p_adjusted=next(groups)) for one in metric.differences),
            stations=tuple(replace(one, p_adjusted=next(stations)) for one in metric.stations),
        )
        for metric in metrics
    ]


def _adjust(p_values: Sequence[float | None], adjustment: Adjustment) -> list[float | None]:
    made = [p for p in p_values if p is not None]
    method = {Adjustment.HOLM: holm, Adjustment.BENJAMINI_HOCHBERG: benjamini_hochberg}.get(adjustment)
    adjusted = iter(made if method is None else method(made).tolist())
    return [None if p is None else float(next(adjusted)) for p in p_values]


def _warnings(members: Sequence[FleetRun], grouping: Grouping, terms: Terms, now: datetime) -> Sequence[str]:
    said = [f"{plural(count, 'run')} {why} and are left out" for why, count in sorted(grouping.left_out.items())]
    said += _groups_warnings(members, grouping, terms)
    for noun, names in (
        ("recipes", [run.recipe for run in members]),
        ("software versions", [] if terms.by is By.SOFTWARE else software_words(members)),
        ("simulated and real benches", ["simulated" if run.simulated else "real" for run in members]),
    ):
        counts = Counter(names)
        if len(counts) > 1:
            shares = "; ".join(f"{name}: {plural(count, 'run')}" for name, count in counts.most_common())
            said.append(f"mixed {noun} ({shares}): a difference of groups may be one of these")
    clocks = clock_warnings(members, now)
    said += clocks
    if clocks and terms.by is By.PERIOD:
        said.append(
            "periods are taken from those clocks: compare by batch, or leave those days out by --since, --until"
        )
    return said


def _groups_warnings(members: Sequence[FleetRun], grouping: Grouping, terms: Terms) -> Sequence[str]:
    said = []
    if len(grouping.names) == 1:
        said.append(f"there is one {terms.by} only, {grouping.reference}: it is described, and compared with nothing")
    said += [
        f"{name} has one sensor only, which says nothing of how sensors differ"
        for name in grouping.names
        if len(grouping.tests[name]) == 1
    ]
    owners = Counter(serial for name in grouping.names for serial in grouping.tests[name])
    several = sorted(serial for serial, count in owners.items() if count > 1)
    if several and terms.by in (By.BATCH, By.MATERIAL):
        said.append(
            f"runs put {plural(len(several), 'sensor')} into several groups, which is a mistake in one of them: "
            f"{named(several)}"
        )
    if terms.by is By.MATERIAL:
        said += _nested(members, grouping)
    return said


def _nested(members: Sequence[FleetRun], grouping: Grouping) -> Sequence[str]:
    batches: dict[str, set[str]] = {name: set() for name in grouping.names}
    for run in members:
        if run.material in batches:
            batches[run.material].add(run.batch or _NO_BATCH)
    single = [name for name in grouping.names if len(batches[name]) == 1]
    if not single:
        return ["batches of one material are taken for alike: how they differ is not in the intervals"]
    listed = ", ".join(f"{name} is batch {next(iter(batches[name]))} only" for name in single)
    return [f"{listed}: a difference of materials cannot be told from one of batches"]
