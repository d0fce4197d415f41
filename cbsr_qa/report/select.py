"""Loads as figures and tables show them, joined with what was measured of them, and the verdict of each location."""

import re
from collections.abc import Iterable, Sequence
from statistics import fmean, stdev

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.results.observation import LoadObservation, RunObservation
from cbsr_qa.report.draw.loads import SeenLoad
from cbsr_qa.report.draw.metrics import Held
from cbsr_qa.report.draw.relaxation import SettledLoad
from cbsr_qa.report.tables import plain, with_uncertainty

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


def list_holds(run: RunObservation, phase: str) -> list[Held]:
    """Return when each load of a phase was held."""
    records = [load.record for load in run.loads if load.phase == phase]
    return [Held(record.load.label, record.hold_start_s, record.release_start_s) for record in records]


def group_by_label(loads: Iterable[LoadObservation]) -> dict[str, list[LoadObservation]]:
    """Group loads by their label, in order of first appearance."""
    groups: dict[str, list[LoadObservation]] = {}
    for load in loads:
        groups.setdefault(load.record.load.label, []).append(load)
    return groups


class Measured:
    """Measurements of single loads, by name, phase, index of the load within its phase, and qualifier."""

    def __init__(self, measurements: Sequence[Measurement]) -> None:
        self._found = {(m.name, m.phase, m.load, m.qualifier): m for m in measurements if m.load is not None}

    def find(self, name: str, load: LoadObservation, qualifier: str = "") -> Measurement | None:
        """Return one measurement of one load; None where no metric took it."""
        return self._found.get((name, load.phase, load.record.index, qualifier))

    def values(self, name: str, loads: Sequence[LoadObservation], qualifier: str = "") -> list[float]:
        """Return the values of one measurement over some loads; those without one are left out."""
        measurements = (self.find(name, load, qualifier) for load in loads)
        return [m.value for m in measurements if m is not None and m.value is not None]


def mean_deviation(values: Sequence[float]) -> tuple[float, float | None] | None:
    """Return mean and standard deviation (None for a single value), or None without values."""
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


def join_loads(loads: Sequence[LoadObservation], run: RunObservation, measured: Measured) -> tuple[SeenLoad, ...]:
    """Join loads with their centre-of-mass error and overlap of the main mask."""
    several = len({load.record.load.trial for load in run.loads}) > 1
    strains = len({round(load.record.load.strain, 6) for load in run.loads}) > 1
    return tuple(_join_load(load, run, measured, title_load(load, trials=several, strains=strains)) for load in loads)


def select_relaxed(loads: Sequence[LoadObservation]) -> tuple[SettledLoad, ...]:
    """Return the loads that have any relaxation."""
    return tuple(
        SettledLoad(load.record.load.label, load.phase, load.record.load.strain, load.relaxations)
        for load in loads
        if load.relaxations
    )


def title_load(load: LoadObservation, *, trials: bool, strains: bool) -> str:
    """Name a load with what tells it from its siblings: ``L3``, ``L3 · 20 %``, ``L3 · 20 % · trial 2``."""
    planned_load = load.record.load
    title_parts = [planned_load.label]
    title_parts += [f"{round(100 * planned_load.strain, 1):g} %"] if strains else []
    title_parts += [f"trial {planned_load.trial + 1}"] if trials and planned_load.trial else []
    return " · ".join(title_parts)


def _join_load(load: LoadObservation, run: RunObservation, measured: Measured, title: str) -> SeenLoad:
    planned_load, view = load.record.load, load.mask(run.main_mask)
    error = measured.find("centre_of_mass_error", load)
    overlap = measured.find("area_overlap", load)
    return SeenLoad(
        label=planned_load.label,
        title=title,
        x_mm=planned_load.x_mm,
        y_mm=planned_load.y_mm,
        radius_mm=load.indenter.radius_mm,
        pressed=load.indenter.footprint_at(planned_load.x_mm, planned_load.y_mm),
        strain=planned_load.strain,
        image=load.image,
        sensed=view.region if view else None,
        error_mm=error.value if error else None,
        overlap_percent=overlap.value if overlap else None,
        outcome=error.outcome if error else Outcome.NOT_JUDGED,
        overlap_outcome=overlap.outcome if overlap else Outcome.NOT_JUDGED,
        group=load.phase,
        error_limits_mm=_bounds(error),
        overlap_limits_percent=_bounds(overlap),
    )


def _bounds(measurement: Measurement | None) -> tuple[float, ...]:
    limit = None if measurement is None else measurement.limit
    return () if limit is None else tuple(bound for bound in (limit.lower, limit.upper) if bound is not None)
