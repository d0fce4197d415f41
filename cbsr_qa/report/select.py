"""Finding loads and measurements: what several sections ask for."""

import re
from collections.abc import Iterable, Sequence
from statistics import fmean, stdev

from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa.domain.report import RunResult
from cbsr_qa.domain.steps import Role
from cbsr_qa.report.numbers import plain, with_uncertainty

#: The spatial metrics: measurement name, heading, unit.
SPATIAL = (
    ("centre_of_mass_error", "E_CoM", "mm"),
    ("area_overlap", "A_OL", "%"),
    ("shape_deviation", "SD", "mm²"),
)


def observed(result: RunResult | RecordingResult) -> RunObservation | None:
    """Return what was observed in a run; None for a recording, or where nothing could be analysed."""
    return result.observation if isinstance(result, RunResult) else None


def loads_of(run: RunObservation, role: Role) -> tuple[LoadObservation, ...]:
    """Return the loads of the phases whose sequence is for this, in time order."""
    phases = {phase.name for phase in run.record.phases if phase.role is role}
    return tuple(load for load in run.loads if load.phase in phases)


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
        found = (self.of_load(name, load, qualifier) for load in loads)
        return [m.value for m in found if m is not None and m.value is not None]


def mask_qualifier(run: RunObservation, fraction: float) -> str:
    """Return the qualifier the metrics give a mask: none for the main one."""
    return "" if abs(fraction - run.main_mask) < 1e-9 else f"mask {100 * fraction:g} %"


def mean_deviation(values: Sequence[float]) -> tuple[float, float | None] | None:
    """Return mean and standard deviation (None for a single value); None where there is no value."""
    if not values:
        return None
    return fmean(values), stdev(values) if len(values) > 1 else None


def spread_text(values: Sequence[float], unit: str = "") -> str:
    """Write mean ± standard deviation of some values; a dash where there are none, no ± for a single one."""
    found = mean_deviation(values)
    if found is None:
        return "–"
    return with_uncertainty(*found) if found[1] else plain(found[0], unit)


def alike(reason: str) -> str:
    """Return a reason without its numbers: reasons that differ in nothing else are told once."""
    return re.sub(r"[\d.,]*\d", "#", reason)
