"""Differences by place: where on the sheet groups differ."""

from dataclasses import dataclass, replace
from typing import Final

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.fleet import FleetTable
from cbsr_qa.fleet.design import Design
from cbsr_qa.fleet.differences import fitted
from cbsr_qa.fleet.figures import MetricFigures
from cbsr_qa.fleet.groups import Grouping
from cbsr_qa.fleet.terms import Terms
from cbsr_qa.stats.multiplicity import holm

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
