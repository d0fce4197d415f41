"""Loads as figures and tables show them, joined with what was measured of them, and the verdict of each location."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev
from typing import Final

from cbsr_qa.domain.plan import Role
from cbsr_qa.domain.results import (
    SEVERITY,
    LoadObservation,
    Measurement,
    Outcome,
    RunObservation,
    metric_words,
    relative_margin,
    worst,
)
from cbsr_qa.report.draw import Held, SeenLoad, SettledLoad
from cbsr_qa.report.tables import limit_text, plain, plural, value_cell, with_uncertainty

#: The spatial metrics: measurement name, heading, unit.
SPATIAL = (
    ("centre_of_mass_error", "E_CoM", "mm"),
    ("area_overlap", "A_OL", "%"),
    ("shape_deviation", "Shape deviation", "mm²"),
)


def loads_of(run: RunObservation, role: Role) -> tuple[LoadObservation, ...]:
    """Return the loads of the phases whose sequence is for this, in time order."""
    phases = {phase.name for phase in run.record.phases if phase.role is role}
    return tuple(load for load in run.loads if load.phase in phases)


def held_loads(run: RunObservation, phase: str) -> list[Held]:
    """Return when each load of a phase was held."""
    records = [load.record for load in run.loads if load.phase == phase]
    return [Held(record.load.label, record.hold_start_s, record.release_start_s) for record in records]


def by_label(loads: Iterable[LoadObservation]) -> dict[str, list[LoadObservation]]:
    """Group loads by their label, in order of first appearance."""
    groups: dict[str, list[LoadObservation]] = {}
    for load in loads:
        groups.setdefault(load.record.load.label, []).append(load)
    return groups


class Measured:
    """Measurements of single loads, by name, phase, index of the load within its phase, and qualifier."""

    def __init__(self, measurements: Sequence[Measurement]) -> None:
        self._found = {(m.name, m.phase, m.load, m.qualifier): m for m in measurements if m.load is not None}

    def of_load(self, name: str, load: LoadObservation, qualifier: str = "") -> Measurement | None:
        """Return one measurement of one load; None where no metric took it."""
        return self._found.get((name, load.phase, load.record.index, qualifier))

    def values(self, name: str, loads: Sequence[LoadObservation], qualifier: str = "") -> list[float]:
        """Return the values of one measurement over some loads; those without one are left out."""
        measurements = (self.of_load(name, load, qualifier) for load in loads)
        return [m.value for m in measurements if m is not None and m.value is not None]


def mean_deviation(values: Sequence[float]) -> tuple[float, float | None] | None:
    """Return mean and standard deviation (None for a single value); None where there is no value."""
    if not values:
        return None
    return fmean(values), stdev(values) if len(values) > 1 else None


def spread_text(values: Sequence[float], unit: str = "") -> str:
    """Write mean ± standard deviation of some values; a dash where there are none, no ± for a single one."""
    spread = mean_deviation(values)
    if spread is None:
        return "–"
    return with_uncertainty(*spread) if spread[1] else plain(spread[0], unit)


def spatial_spreads(measured: Measured, loads: Sequence[LoadObservation], qualifier: str = "") -> list[str]:
    """Write mean ± standard deviation of the spatial metrics over some loads, and how many of the loads were seen."""
    values = [measured.values(name, loads, qualifier) for name, _, _ in SPATIAL]
    spreads = [spread_text(of_metric, unit) for of_metric, (_, _, unit) in zip(values, SPATIAL, strict=True)]
    return [*spreads, f"{len(values[0])} of {len(loads)}"]


def alike(reason: str) -> str:
    """Return a reason without its numbers: reasons that differ in nothing else are told once."""
    return re.sub(r"[\d.,]*\d", "#", reason)


def seen_loads(loads: Sequence[LoadObservation], run: RunObservation, measured: Measured) -> tuple[SeenLoad, ...]:
    """Join loads with their centre-of-mass error and overlap of the main mask."""
    several = len({load.record.load.trial for load in run.loads}) > 1
    strains = len({round(load.record.load.strain, 6) for load in run.loads}) > 1
    return tuple(_seen(load, run, measured, titled(load, trials=several, strains=strains)) for load in loads)


def settled_loads(loads: Sequence[LoadObservation]) -> tuple[SettledLoad, ...]:
    """Return the loads that have any relaxation."""
    return tuple(
        SettledLoad(load.record.load.label, load.phase, load.record.load.strain, load.relaxations)
        for load in loads
        if load.relaxations
    )


def titled(load: LoadObservation, *, trials: bool, strains: bool) -> str:
    """Name a load with what tells it from its siblings: ``L3``, ``L3 · 20 %``, ``L3 · 20 % · trial 2``."""
    wanted = load.record.load
    parts = [wanted.label]
    parts += [f"{round(100 * wanted.strain, 1):g} %"] if strains else []
    parts += [f"trial {wanted.trial + 1}"] if trials and wanted.trial else []
    return " · ".join(parts)


def _seen(load: LoadObservation, run: RunObservation, measured: Measured, title: str) -> SeenLoad:
    wanted, view = load.record.load, load.mask(run.main_mask)
    error = measured.of_load("centre_of_mass_error", load)
    overlap = measured.of_load("area_overlap", load)
    return SeenLoad(
        label=wanted.label,
        title=title,
        x_mm=wanted.x_mm,
        y_mm=wanted.y_mm,
        radius_mm=load.indenter.radius_mm,
        pressed=load.indenter.at(wanted.x_mm, wanted.y_mm),
        strain=wanted.strain,
        image=load.image,
        sensed=view.region if view else None,
        error_mm=error.value if error else None,
        overlap_percent=overlap.value if overlap else None,
        outcome=error.outcome if error else Outcome.NOT_JUDGED,
        overlap_outcome=overlap.outcome if overlap else Outcome.NOT_JUDGED,
        group=load.phase,
    )


#: What stands before an outcome, so that it reads without colour.
SIGNS: Final = {Outcome.PASS: "✓", Outcome.FAIL: "✗", Outcome.MARGINAL: "≈", Outcome.NOT_MEASURED: "?"}
#: Locations that are named in words; of more the worst ones are.
_MOST_NAMED: Final = 6


def outcome_counts(outcomes: Sequence[Outcome]) -> str:
    """Count outcomes in words, the best first: ``7 pass, 1 marginal, 1 fail``."""
    counts = Counter(outcomes)
    return ", ".join(f"{counts[outcome]} {outcome.value}" for outcome in reversed(SEVERITY) if counts[outcome])


@dataclass(frozen=True, slots=True)
class LocationVerdict:
    """What was judged at one place of a phase, over all its trials and strains.

    Parameters
    ----------
    deciding : of the worst outcome, the measurement closest to (or furthest beyond) its limit.
    judged : how many measurements.
    """

    phase: str
    label: str
    x_mm: float
    y_mm: float
    outcome: Outcome
    deciding: Measurement
    judged: int


def location_verdicts(run: RunObservation, judged: Sequence[Measurement]) -> tuple[LocationVerdict, ...]:
    """Return the verdicts of all places where a single load was judged, in the order they were pressed."""
    at = {(load.phase, load.record.index): load.record.load for load in run.loads}
    groups: dict[tuple[str, str, float, float], list[Measurement]] = {}
    for m in judged:
        if m.load is not None and (place := at.get((m.phase, m.load))) is not None:
            groups.setdefault((m.phase, place.label, place.x_mm, place.y_mm), []).append(m)
    order = {phase.name: number for number, phase in enumerate(run.record.phases)}
    verdicts = []
    for (phase, label, x_mm, y_mm), members in groups.items():
        outcome = worst(m.outcome for m in members)
        deciding = min((m for m in members if m.outcome is outcome), key=relative_margin)
        verdicts.append(LocationVerdict(phase, label, x_mm, y_mm, outcome, deciding, len(members)))
    return tuple(sorted(verdicts, key=lambda verdict: order.get(verdict.phase, 0)))


def verdicts_in_words(verdicts: Sequence[LocationVerdict]) -> str:
    """Say which locations did not pass, and what decided; the worst first."""
    kept = [verdict for verdict in verdicts if verdict.outcome is not Outcome.PASS]
    if not kept:
        return f"By location: all {len(verdicts)} pass." if len(verdicts) > 1 else "By location: the only one passes."
    kept.sort(key=lambda verdict: (SEVERITY.index(verdict.outcome), relative_margin(verdict.deciding)))
    named = "; ".join(_named(verdict) for verdict in kept[:_MOST_NAMED])
    more = len(kept) - _MOST_NAMED
    named += f"; and {more} more" if more > 0 else ""
    passed = len(verdicts) - len(kept)
    rest = f" The other {passed} pass." if passed > 1 else " The other one passes." if passed else ""
    return f"By location, {plural(len(kept), 'does', 'do')} not simply pass: {named}.{rest}"


def _named(verdict: LocationVerdict) -> str:
    m = verdict.deciding
    assert m.limit is not None
    name = metric_words(m.name)
    if m.value is None:
        return f"{verdict.label} ({verdict.phase}) {verdict.outcome}, {name}: {m.how}"
    value, limit = value_cell(m, unit=True).text, limit_text(m.limit)
    return f"{verdict.label} ({verdict.phase}) {verdict.outcome}, {name} {value} (limit {limit})"
