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
#: Joint confidence that an unchanged station is within all intervals: beyond it fails, or warns.
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
    runs, unlike = [], 0
    for other in reversed(store.runs.find(identity.sensor.serial)):
        if other.recipe != identity.recipe or other.end is not EndReason.FINISHED or other.run >= run:
            continue
        if other.altered:
            raise StoreError(other.altered, remedy="restore the database from a copy")
        analyses = store.analyses.load(other.run)
        adoption = analyses[0].adoption if analyses else None
        measuring = measuring_digest(
            store.runs.read_configuration(other.run), "" if adoption is None else adoption.recipe
        )
        if not analyses or measuring != digest:
            unlike += 1
            continue
        runs.append(GoldenRun(other.run, other.station, figures_of(analyses[0].measurements)))
    return GoldenHistory(tuple(runs), unlike)


def figures_of(measurements: Sequence[Measurement]) -> dict[str, Figure]:
    """Return the comparable values of a run: measured at every place, and not only bounded."""
    figures = {}
    for name, qualifier in FIGURES:
        of = [m for m in measurements if (m.name, m.qualifier) == (name, qualifier)]
        values = [m.value for m in of if m.value is not None and m.bound is Bound.EXACT]
        if values and len(values) == len(of):
            figures[name] = Figure(float(np.mean(values)), len(values), of[0].unit)
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
    measurements, station : of the new run.
    subject : of the lines.
    """
    new = figures_of(measurements)
    here = [run for run in history.runs if run.station == station]
    elsewhere = [run for run in history.runs if run.station != station]
    groups = [("here", here), (_stations(elsewhere), elsewhere)]
    compared = {
        (name, where): values
        for name, figure in new.items()
        for where, runs in groups
        if len(values := _values(name, figure, runs)) >= FEWEST_VALUES
    }
    lines = [_rests_on(here, elsewhere, history.unlike, subject)]
    for name, _ in FIGURES:
        if name not in new:
            lines.append(_lacking(name, [run for run in history.runs if name in run.figures], subject))
            continue
        own = {where: compared[name, where] for where, _ in groups if (name, where) in compared}
        lines.append(_line(name, new[name], own, len(compared), subject))
    return tuple(lines)


def _lacking(name: str, had: Sequence[GoldenRun], subject: str) -> CheckResult:
    """Line of a value that could not be measured: a failure if earlier runs had it."""
    why, lost = "it could not be measured in this run", len(had) >= FEWEST_VALUES
    return CheckResult(
        metric_words(name),
        CheckOutcome.FAILED if lost else CheckOutcome.NOT_DONE,
        said=f"{why}; {_runs(len(had))} had it" if lost else why,
        remedy="the report of this run says why" if lost else "",
        subject=subject,
    )


def _values(name: str, figure: Figure, runs: Sequence[GoldenRun]) -> list[float]:
    """Values in earlier runs, over as many places and in the same unit."""
    of = [run.figures[name] for run in runs if name in run.figures]
    return [other.value for other in of if (other.places, other.unit) == (figure.places, figure.unit)]


def _rests_on(here: Sequence[GoldenRun], elsewhere: Sequence[GoldenRun], unlike: int, subject: str) -> CheckResult:
    enough = max(len(here), len(elsewhere)) >= FEWEST_VALUES
    counts = f"{_runs(len(here))} at this station, {len(elsewhere)} at others"
    counts += f" ({_stations(elsewhere)})" if elsewhere else ""
    counts += f"; {_runs(unlike)} with another recipe, sensor type or head left out" if unlike else ""
    return CheckResult(
        "history",
        CheckOutcome.OK if enough else CheckOutcome.NOT_DONE,
        value=float(len(here) + len(elsewhere)),
        unit="1",
        said=counts,
        remedy="" if enough else f"no verdict on its figures before {FEWEST_VALUES} earlier runs; this one counts",
        subject=subject,
    )


def _line(
    name: str, figure: Figure, compared: Mapping[str, list[float]], comparisons: int, subject: str
) -> CheckResult:
    value, shown = figure.value, metric_words(name)
    if not compared:
        why = f"fewer than {FEWEST_VALUES} earlier runs to compare with"
        return CheckResult(shown, CheckOutcome.NOT_DONE, value=value, unit=figure.unit, said=why, subject=subject)
    outcomes, means, allowed = [CheckOutcome.OK], [], []
    for where, values in compared.items():
        fails = predict(values, confidence=1 - (1 - FAILS_BEYOND) / comparisons)
        warns = predict(values, confidence=1 - (1 - WARNS_BEYOND) / comparisons)
        outside = CheckOutcome.FAILED if not fails.holds(value) else CheckOutcome.WARNING
        outcomes += [] if warns.holds(value) else [outside]
        means.append(f"{where} {with_uncertainty(fails.mean, fails.deviation)} in {_runs(fails.count)}")
        reach = f"{_like(fails.low, fails)} to {_like(fails.high, fails)} {unit_shown(figure.unit)}".rstrip()
        allowed.append(f"{reach} ({where})")
    outcome = CheckOutcome.FAILED if CheckOutcome.FAILED in outcomes else outcomes[-1]
    return CheckResult(
        shown,
        outcome,
        value=value,
        unit=figure.unit,
        allowed="; ".join(allowed),
        said="; ".join(means),
        remedy="" if outcome is CheckOutcome.OK else _CHANGED,
        subject=subject,
    )


def _like(value: float, prediction: Prediction) -> str:
    """Write a bound with digits that match the spread of the values."""
    decimals = 1 - floor(log10(prediction.deviation)) if prediction.deviation > 0 else _MOST_DECIMALS
    few = abs(prediction.mean) >= 0.01 and 0 <= decimals <= _MOST_DECIMALS
    return format_fixed(value, decimals) if few else number(value)


def _stations(runs: Sequence[GoldenRun]) -> str:
    return ", ".join(sorted({run.station for run in runs})) or "elsewhere"


def _runs(count: int) -> str:
    return f"{count} earlier run{'' if count == 1 else 's'}"
