"""A golden sensor's run compared with its earlier runs, at this station and at others."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import floor, log10
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Bound
from cbsr_qa.domain.results.measurement import Measurement, metric_words
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult
from cbsr_qa.report.tables import format_fixed, number, unit_shown, with_uncertainty
from cbsr_qa.stats.intervals import FEWEST_VALUES, Prediction, predict
from cbsr_qa.store.repository import Repository
from cbsr_qa.studies.selection import measuring_digest

#: Compared values: measurement, and its qualifier if any. Values at several places are averaged.
FIGURES: Final = (
    ("force", ""),
    ("amplitude_response", ""),
    ("centre_of_mass_error", ""),
    ("area_overlap", ""),
    ("interelectrode_resistance", ""),
    ("contact_resistance_ratio", ""),
    ("channel_snr", "median"),
    ("conductance_noise", ""),
    ("noise_floor", ""),
    ("reciprocity_error", ""),
    ("drift", ""),
)
#: Joint confidence that an unchanged station is within all intervals: values outside of them fail, or warn.
FAILS_BEYOND: Final = 0.99
WARNS_BEYOND: Final = 0.95
_MOST_DECIMALS: Final = 9

_CHANGED: Final = (
    "measure it again; if it stays so, a second golden sensor tells if the station or this sensor changed"
)


@dataclass(frozen=True, slots=True)
class Figure:
    """A value of one run: the mean over its places."""

    value: float
    places: int
    unit: str


@dataclass(frozen=True, slots=True)
class GoldenRun:
    """An earlier run of the sensor: its station, and its values by name."""

    run: str
    station: str
    figures: Mapping[str, Figure]


@dataclass(frozen=True, slots=True)
class GoldenHistory:
    """Earlier runs of a golden sensor, oldest first, and the number of other runs, which are left out."""

    runs: tuple[GoldenRun, ...]
    unlike: int


def golden_history(store: Repository, run: str) -> GoldenHistory:
    """Return the earlier runs of a run's sensor that were finished with the same recipe, sensor type and head.

    Parameters
    ----------
    run : the golden sensor's new run; what began after it is left out.

    Raises
    ------
    StoreError
        If it is not stored.
    """
    identity, digest = store.runs.read_identity(run), measuring_digest(store.runs.read_configuration(run))
    runs, unlike_count = [], 0
    for other_run in reversed(store.runs.find(identity.sensor.serial)):
        if other_run.recipe != identity.recipe or other_run.end is not EndReason.FINISHED or other_run.run >= run:
            continue
        if other_run.altered:
            raise StoreError(other_run.altered, remedy="restore the database from a copy")
        analyses = store.analyses.load(other_run.run)
        adoption = analyses[0].adoption if analyses else None
        measuring = measuring_digest(
            store.runs.read_configuration(other_run.run), "" if adoption is None else adoption.recipe
        )
        if not analyses or measuring != digest:
            unlike_count += 1
            continue
        runs.append(GoldenRun(other_run.run, other_run.station, figures_of(analyses[0].measurements)))
    return GoldenHistory(tuple(runs), unlike_count)


def figures_of(measurements: Sequence[Measurement]) -> dict[str, Figure]:
    """Return the comparable values of a run: measured at every place, and not only bounded."""
    figures = {}
    for name, qualifier in FIGURES:
        members = [m for m in measurements if (m.name, m.qualifier) == (name, qualifier)]
        values = [m.value for m in members if m.value is not None and m.bound is Bound.EXACT]
        if values and len(values) == len(members):
            figures[name] = Figure(float(np.mean(values)), len(values), members[0].unit)
    return figures


def compare_golden(
    measurements: Sequence[Measurement], history: GoldenHistory, *, station: str, subject: str
) -> tuple[CheckResult, ...]:
    """Compare a golden run with its history: one line per value, and one for the number of runs.

    Each value is compared with earlier runs at this station and, separately, at all others. Prediction intervals for
    one further run (Student's t) hold jointly for all comparisons (Bonferroni). Fewer than three earlier runs give no
    verdict.

    Parameters
    ----------
    measurements, station : measurements and station of the new run.
    subject : subject of the lines.
    """
    new_figures = figures_of(measurements)
    runs_here = [run for run in history.runs if run.station == station]
    runs_elsewhere = [run for run in history.runs if run.station != station]
    groups = [("here", runs_here), (_stations(runs_elsewhere), runs_elsewhere)]
    compared = {}
    for name, figure in new_figures.items():
        for stations, runs in groups:
            earlier = [run.figures[name] for run in runs if name in run.figures]
            # Over as many places, and in the same unit.
            values = [one.value for one in earlier if (one.places, one.unit) == (figure.places, figure.unit)]
            if len(values) >= FEWEST_VALUES:
                compared[name, stations] = values
    lines = [_describe_history(runs_here, runs_elsewhere, history.unlike, subject)]
    for name, _ in FIGURES:
        if name not in new_figures:
            lines.append(_lacking(name, [run for run in history.runs if name in run.figures], subject))
            continue
        values_by_stations = {
            stations: compared[name, stations] for stations, _ in groups if (name, stations) in compared
        }
        lines.append(_line(name, new_figures[name], values_by_stations, len(compared), subject))
    return tuple(lines)


def _lacking(name: str, had: Sequence[GoldenRun], subject: str) -> CheckResult:
    """Line of a value that could not be measured: a failure if earlier runs had it."""
    reason, is_lost = "it could not be measured in this run", len(had) >= FEWEST_VALUES
    return CheckResult(
        metric_words(name),
        CheckOutcome.FAILED if is_lost else CheckOutcome.NOT_DONE,
        said=f"{reason}; {_runs(len(had))} had it" if is_lost else reason,
        remedy="the report of this run says why" if is_lost else "",
        subject=subject,
    )


def _describe_history(
    here: Sequence[GoldenRun], elsewhere: Sequence[GoldenRun], unlike: int, subject: str
) -> CheckResult:
    is_enough = max(len(here), len(elsewhere)) >= FEWEST_VALUES
    counts_text = f"{_runs(len(here))} at this station, {len(elsewhere)} at others"
    counts_text += f" ({_stations(elsewhere)})" if elsewhere else ""
    counts_text += f"; {_runs(unlike)} with another recipe, sensor type or head left out" if unlike else ""
    return CheckResult(
        "history",
        CheckOutcome.OK if is_enough else CheckOutcome.NOT_DONE,
        value=float(len(here) + len(elsewhere)),
        unit="1",
        said=counts_text,
        remedy="" if is_enough else f"no verdict on its figures before {FEWEST_VALUES} earlier runs; this one counts",
        subject=subject,
    )


def _line(
    name: str, figure: Figure, compared: Mapping[str, list[float]], comparisons: int, subject: str
) -> CheckResult:
    value, title = figure.value, metric_words(name)
    if not compared:
        reason = f"fewer than {FEWEST_VALUES} earlier runs to compare with"
        return CheckResult(title, CheckOutcome.NOT_DONE, value=value, unit=figure.unit, said=reason, subject=subject)
    outcomes, means, allowed_ranges = [CheckOutcome.OK], [], []
    for stations, values in compared.items():
        fails = predict(values, confidence=1 - (1 - FAILS_BEYOND) / comparisons)
        warns = predict(values, confidence=1 - (1 - WARNS_BEYOND) / comparisons)
        outside = CheckOutcome.FAILED if not fails.holds(value) else CheckOutcome.WARNING
        outcomes += [] if warns.holds(value) else [outside]
        means.append(f"{stations} {with_uncertainty(fails.mean, fails.deviation)} in {_runs(fails.count)}")
        reach = f"{_format_like(fails.low, fails)} to {_format_like(fails.high, fails)}"
        reach = f"{reach} {unit_shown(figure.unit)}".rstrip()
        allowed_ranges.append(f"{reach} ({stations})")
    outcome = CheckOutcome.FAILED if CheckOutcome.FAILED in outcomes else outcomes[-1]
    return CheckResult(
        title,
        outcome,
        value=value,
        unit=figure.unit,
        allowed="; ".join(allowed_ranges),
        said="; ".join(means),
        remedy="" if outcome is CheckOutcome.OK else _CHANGED,
        subject=subject,
    )


def _format_like(value: float, prediction: Prediction) -> str:
    """Write a bound with digits that match the spread of the values."""
    decimals = 1 - floor(log10(prediction.deviation)) if prediction.deviation > 0 else _MOST_DECIMALS
    few = abs(prediction.mean) >= 0.01 and 0 <= decimals <= _MOST_DECIMALS
    return format_fixed(value, decimals) if few else number(value)


def _stations(runs: Sequence[GoldenRun]) -> str:
    return ", ".join(sorted({run.station for run in runs})) or "elsewhere"


def _runs(count: int) -> str:
    return f"{count} earlier run{'' if count == 1 else 's'}"
