"""A lot's measurements grouped by limit: the same name, phase and qualifier, every location and trial."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.limits import Bound, Limit
from cbsr_qa.domain.results.fleet import MetricKey
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.studies.limits.golden_lot import Lot, LotRun
from cbsr_qa.studies.selection import missing_metric_error

Taken = Mapping[MetricKey, tuple[Measurement, ...]]


@dataclass(frozen=True, slots=True)
class Group:
    """Values judged by one limit in every run of a lot (one tuple per run), and the latest run's limit, if any."""

    key: MetricKey
    unit: str
    sensors: Mapping[str, tuple[tuple[Measurement, ...], ...]]
    present: Limit | None

    @property
    def values(self) -> int:
        """Number of values per run; if runs differ, the largest."""
        return max(len(run) for runs in self.sensors.values() for run in runs)

    def why_not(self) -> str:
        """Why no statistics are possible; empty if they are."""
        for serial, runs in self.sensors.items():
            for run in runs:
                nothing = [m for m in run if m.value is None]
                if nothing:
                    why = nothing[0].how or "no reason given"
                    return f"{serial} has no value in {len(nothing)} of {len(run)}: {why}"
        censored = [
            serial
            for serial, runs in self.sensors.items()
            if any(m.bound is Bound.LOWER for run in runs for m in run)
        ]
        if censored:
            return f"of {', '.join(censored)} only lower bounds are known (≥): hold longer, so that it is measured"
        counts = {len(run): serial for serial, runs in self.sensors.items() for run in runs}
        if len(counts) > 1:
            count_words = " and ".join(f"{count} (such as {serial})" for count, serial in sorted(counts.items()))
            return f"runs have different numbers of values: {count_words}"
        return ""


def groups_of(lot: Lot, names: Sequence[str], everything: bool) -> tuple[Group, ...]:
    """Group a lot's measurements: the named ones, all, or those limited by the recipe (all if it has no limits).

    RefusedError if no run measured a name (with the nearest one), or one measurement has several units.
    """
    runs = {serial: tuple(_group_by_key(run) for run in members) for serial, members in lot.analysed.items()}
    latest = _group_by_key(max(lot.runs, key=lambda run: run.line.started_at))
    keys = dict.fromkeys((*latest, *(key for members in runs.values() for run in members for key in run)))
    measured_names = {key.name for key in keys}
    for name in names:
        if name not in measured_names:
            raise missing_metric_error(name, measured_names)
    groups = [_group(key, runs, latest) for key in keys if not names or key.name in names]
    limited_groups = [group for group in groups if group.present is not None]
    return tuple(groups if names or everything or not limited_groups else limited_groups)


def _group_by_key(run: LotRun) -> Taken:
    measurements_by_key: dict[MetricKey, tuple[Measurement, ...]] = {}
    for measurement in run.analysis.measurements:
        key = MetricKey(measurement.name, measurement.phase, measurement.qualifier)
        measurements_by_key[key] = (*measurements_by_key.get(key, ()), measurement)
    return measurements_by_key


def _group(key: MetricKey, lot: Mapping[str, tuple[Taken, ...]], latest: Taken) -> Group:
    sensors = {serial: tuple(run.get(key, ()) for run in runs) for serial, runs in lot.items()}
    units: dict[str, str] = {}
    for serial, runs in sensors.items():
        for measurement in (m for run in runs for m in run):
            units.setdefault(measurement.unit, serial)
    if len(units) > 1:
        units_words = " and ".join(f"{unit} ({serial})" for unit, serial in units.items())
        raise RefusedError(
            f"{key.name} is in {units_words}: values in different units cannot form a lot",
            remedy="leave the sensors of one unit out by --without, or analyse all with one version",
        )
    limits = [m.limit for m in latest.get(key, ()) if m.limit is not None]
    return Group(key, next(iter(units)), sensors, limits[0] if limits else None)
