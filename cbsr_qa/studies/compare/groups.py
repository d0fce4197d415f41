"""Which run belongs to which group, and which of a sensor's runs decides."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from difflib import get_close_matches

import numpy as np

from cbsr_qa.domain import RefusedError
from cbsr_qa.domain.results import FleetRun, Outcome
from cbsr_qa.stats import IntArray
from cbsr_qa.studies.compare.figures import BoolArray
from cbsr_qa.studies.compare.terms import By, Period, Policy, Terms

_PASSED = (Outcome.PASS, Outcome.MARGINAL)


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """Runs sorted into groups.

    Parameters
    ----------
    names : of the groups, the reference first.
    labels : (R,) group of each run; empty where it is left out.
    used : (R,) whether a run counts.
    tests : group → sensor → indices of its runs that count, in the order they were made in.
    left_out : reason in words, of one run and of several → how many runs.
    """

    names: tuple[str, ...]
    labels: tuple[str, ...]
    used: BoolArray
    tests: Mapping[str, Mapping[str, tuple[int, ...]]]
    left_out: Mapping[tuple[str, str], int]

    @property
    def reference(self) -> str:
        """The group the others are compared with."""
        return self.names[0]

    def deciding(self, runs: Sequence[FleetRun], policy: Policy) -> dict[str, IntArray]:
        """Return the run of each sensor that decides, by group."""
        return {
            name: np.array([decides(runs, tests, policy) for tests in self.tests[name].values()], dtype=np.intp)
            for name in self.names
        }


def grouped(runs: Sequence[FleetRun], terms: Terms) -> Grouping:
    """Sort runs into groups.

    Raises
    ------
    RefusedError
        If no run was finished and analysed, or a group that was named has no runs (with the nearest name).
    """
    labels = _labels(runs, terms.by, terms.period)
    left_out: Counter[tuple[str, str]] = Counter()
    kept = []
    for run, label in zip(runs, labels, strict=True):
        why = _left_out(run, label, terms.by)
        if why is not None:
            left_out[why] += 1
        kept.append("" if why else label)
    if not any(kept):
        raise RefusedError(
            f"of {len(runs)} stored runs none was finished and analysed, with its {terms.by} stated"
            if runs
            else "no stored run fits",
            remedy="test sensors first, or choose other runs; cbsr-qa db status shows which database is used",
        )
    names = _names(runs, kept, terms)
    kept = [label if label in names else "" for label in kept]
    found: dict[str, dict[str, list[int]]] = {name: {} for name in names}
    for index, (run, label) in enumerate(zip(runs, kept, strict=True)):
        if label:
            found[label].setdefault(run.serial, []).append(index)
    tests = {name: {serial: tuple(indices) for serial, indices in found[name].items()} for name in names}
    used = np.array([bool(label) for label in kept], dtype=bool)
    return Grouping(names, tuple(kept), used, tests, left_out)


def decides(runs: Sequence[FleetRun], tests: Sequence[int], policy: Policy) -> int:
    """Return which of a sensor's runs decides."""
    if policy is Policy.FIRST:
        return tests[0]
    if policy is Policy.ANY:
        return next((index for index in tests if runs[index].outcome in _PASSED), tests[-1])
    return tests[-1]


def software_words(runs: Sequence[FleetRun]) -> list[str]:
    """Name the software each run was analysed with: of what is not the same for all, and the program itself."""
    versions = {run.software for run in runs}
    common = set.intersection(*(set(pairs) for pairs in versions)) if versions else set()
    said = {
        pairs: ", ".join(
            f"{name} {version}" for name, version in pairs if (name, version) not in common or name == "cbsr-qa"
        )
        for pairs in versions
    }
    return [said[run.software] for run in runs]


def period_of(moment: datetime, period: Period) -> str:
    """Name the period a moment lies in: ``2026``, ``2026-11``, ``2026-W47`` or ``2026-11-22``."""
    day = moment.astimezone(UTC).date()
    if period is Period.WEEK:
        year, week, _ = day.isocalendar()
        return f"{year}-W{week:02d}"
    return {Period.YEAR: f"{day:%Y}", Period.MONTH: f"{day:%Y-%m}"}.get(period, day.isoformat())


def _labels(runs: Sequence[FleetRun], by: By, period: Period) -> list[str]:
    if by is By.SOFTWARE:
        return software_words(runs)
    if by is By.PERIOD:
        return [period_of(run.started_at, period) for run in runs]
    return [str(getattr(run, by.value)) for run in runs]


def _left_out(run: FleetRun, label: str, by: By) -> tuple[str, str] | None:
    """Say why a run does not count, of one run and of several; None where it does."""
    if run.of_check:
        return "is a golden sensor's that checked its station", "are golden sensors' that checked their station"
    if not run.finished:
        return "did not run to its end", "did not run to their end"
    if run.outcome is None:
        return "was never analysed", "were never analysed"
    return None if label else (f"does not state its {by}", f"do not state their {by}")


def _names(runs: Sequence[FleetRun], labels: Sequence[str], terms: Terms) -> tuple[str, ...]:
    """Names of the groups, the reference first: as they were given, or the one with most sensors and the others.

    Of periods the reference is the earliest: what is asked is what changed since.
    """
    sensors: dict[str, set[str]] = {}
    for run, label in zip(runs, labels, strict=True):
        if label:
            sensors.setdefault(label, set()).add(run.serial)
    if terms.groups:
        _check_known(terms.groups, sorted(sensors), terms.by)
        return tuple(dict.fromkeys(terms.groups))
    reference = min(sensors, key=lambda name: reference_rank(name, len(sensors[name]), terms.by))
    return (reference, *(name for name in sorted(sensors) if name != reference))


def reference_rank(name: str, sensors: int, by: By) -> tuple[int, str]:
    """Sort groups as references are chosen: the earliest period, or most sensors."""
    # Names of periods of one length sort as their time does.
    return (0 if by is By.PERIOD else -sensors, name)


def _check_known(wanted: Iterable[str], known: Sequence[str], by: By) -> None:
    for name in wanted:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            shown = ", ".join(known[:10]) + (f" and {len(known) - 10} more" if len(known) > 10 else "")
            raise RefusedError(
                f"no run that counts is of {by} {name[:64]!r}",
                remedy=(f"did you mean {near[0]!r}? " if near else "") + f"there are: {shown}",
            )
