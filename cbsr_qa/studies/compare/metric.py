"""One metric compared: groups described, their differences, those of stations, and what the design leaves open.

Differences by place: where on the sheet groups differ.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cbsr_qa.domain import Array, NumericsError
from cbsr_qa.domain.results import FleetRun, FleetTable
from cbsr_qa.stats import IntArray, holm
from cbsr_qa.studies.compare.describe import Described, described
from cbsr_qa.studies.compare.design import Design
from cbsr_qa.studies.compare.differences import REFUSED, Difference, Fitted, difference, fitted
from cbsr_qa.studies.compare.figures import MetricFigures
from cbsr_qa.studies.compare.groups import Grouping
from cbsr_qa.studies.compare.terms import Terms

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


def differences_by_place(
    figures: MetricFigures, table: FleetTable, grouping: Grouping, design: Design, terms: Terms
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


#: What all places of a grid share is how the disc was seated and where the axes are: the station's, not the sensor's.
OF_THE_STATION: Final = ("registration_shift", "registration_rotation", "registration_scale")
_ELSEWHERE: Final = "on other stations"
_APART: Final = f"not compared with groups {_ELSEWHERE}"
_WITH_BATCH: Final = "group and each station's batches"
_SHARES_PLACES: Final = {"centre_of_mass_error": "registered_centre_of_mass_error"}


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
    samples: tuple[tuple[str, str, Array], ...]
    notes: tuple[str, ...]


def metric_comparison(
    figures: MetricFigures,
    table: FleetTable,
    grouping: Grouping,
    deciding: Mapping[str, IntArray],
    design: Design,
    terms: Terms,
) -> MetricComparison:
    """Compare groups and stations in one metric; p values are not adjusted yet.

    Parameters
    ----------
    deciding : group → indices of the runs that decide its sensors.
    """
    label, runs = figures.key.label, table.runs
    model = fitted(design.crossing, figures.mean[design.rows], label, of_stations=design.of_stations)
    of_station = figures.key.name in OF_THE_STATION and not design.of_stations and len(design.stations) > 1
    known = {name: indices[~np.isnan(figures.mean[indices])] for name, indices in deciding.items()}
    differences = [
        _between(model, figures, known, (name, grouping.reference), design, terms)
        for name in grouping.names[1:]
        if not of_station
    ]
    return MetricComparison(
        figures=figures,
        described=tuple(described(figures, runs, name, known[name], terms) for name in grouping.names),
        differences=tuple(differences),
        stations=tuple(_stations(_of_the_stations(model, figures, design), design.stations, terms)),
        maps={} if of_station else differences_by_place(figures, table, grouping, design, terms),
        samples=_samples(figures, runs, known),
        notes=_notes(model, figures, table, design, of_station=of_station),
    )


def _between(
    model: Fitted,
    figures: MetricFigures,
    known: Mapping[str, IntArray],
    names: tuple[str, str],
    design: Design,
    terms: Terms,
) -> Difference:
    first, second = (known[name] for name in names)
    values = figures.mean[first], figures.mean[second]
    at = [[design.sides[index] for index in indices.tolist()] for indices in (first, second)]
    found = difference(model, figures, names, values, (at[0], at[1]), terms)
    if found.model == REFUSED:
        why = "" if model.fit is None else design.untold(model.fit.design, *names)
        return replace(found, warnings=(why,)) if why else found
    return replace(found, model=found.model.replace("group and station", _WITH_BATCH)) if design.levels else found


def _of_the_stations(model: Fitted, figures: MetricFigures, design: Design) -> Fitted:
    """The model that stations are compared by."""
    if design.of_the_stations is design.crossing or not design.stations:
        return model
    return fitted(design.of_the_stations, figures.mean[design.rows], figures.key.label, of_stations=True)


def _stations(model: Fitted, stations: tuple[str, ...], terms: Terms) -> Sequence[Difference]:
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


def _samples(
    figures: MetricFigures, runs: Sequence[FleetRun], known: Mapping[str, IntArray]
) -> tuple[tuple[str, str, Array], ...]:
    found = []
    for name, indices in known.items():
        at: dict[str, list[int]] = {}
        for index in indices.tolist():
            at.setdefault(runs[index].station, []).append(index)
        found += [(name, station, figures.mean[members]) for station, members in sorted(at.items())]
    return tuple(found)


def _notes(
    model: Fitted, figures: MetricFigures, table: FleetTable, design: Design, *, of_station: bool
) -> tuple[str, ...]:
    notes = [*figures.warnings, *(model.fit.notes if model.fit else ())]
    if design.levels:
        # Batches at stations, which the model knows as stations; what is not compared is said elsewhere.
        notes = [note.replace(_ELSEWHERE, "of other batches or stations") for note in notes if _APART not in note]
    if of_station:
        notes.append("what all places share counts against the station: stations are compared in it, groups are not")
    without = _SHARES_PLACES.get(figures.key.name)
    if without is not None:
        measured = any(kind.key.name == without for kind in table.kinds)
        also = f"; {without} is without" if measured else ""
        notes.append(f"it holds what all places share, which is the station's{also}")
    return tuple(notes)
