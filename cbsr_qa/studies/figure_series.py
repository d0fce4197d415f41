"""Figures of one metric over many runs: in one unit, of one number of places, with what was left out said."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, timedelta
from itertools import pairwise
from typing import Final, TypeVar

from cbsr_qa.domain import RefusedError, did_you_mean, of_kind
from cbsr_qa.domain.results import MetricKey, RunFigure, RunLine
from cbsr_qa.plugin import echo
from cbsr_qa.report import named, plural
from cbsr_qa.store import Repository
from cbsr_qa.studies.limits import measuring_digest

_T = TypeVar("_T")

#: Runs may be stored a little out of the order they began in; beyond this a clock was wrong.
_CLOCK_STEP: Final = timedelta(days=1)


@dataclass(frozen=True, slots=True)
class Series:
    """One metric over runs, in the order of the runs' names.

    Parameters
    ----------
    lines, values : of the runs that have it, alike in length.
    lower, upper : limits of the latest run; None where there was none on that side.
    notes : what was left out and why, in sentences.
    """

    key: MetricKey
    unit: str
    lines: tuple[RunLine, ...]
    values: tuple[float, ...]
    lower: float | None
    upper: float | None
    notes: tuple[str, ...]

    @property
    def tolerance(self) -> float | None:
        """Width of the limits; None where there is one or none."""
        return None if self.lower is None or self.upper is None else self.upper - self.lower


def series_of(lines: Sequence[RunLine], figures: Iterable[RunFigure], names: Sequence[str] = ()) -> list[Series]:
    """Put figures in order, one series a metric.

    Parameters
    ----------
    names : measurements wanted, all variants of each; none for those with limits, or all where none has any.

    Raises
    ------
    RefusedError
        If no run measured a name, with the nearest one; or no run measured anything.
    """
    by_key = figures_by_run(figures)
    _check_names(names, by_key)
    limited = [key for key, of in by_key.items() if any(_has_limit(one) for one in of.values())]
    wanted = [key for key in by_key if key.name in names] if names else limited or list(by_key)
    return [_series(key, lines, by_key[key]) for key in wanted]


def figures_by_run(figures: Iterable[RunFigure]) -> dict[MetricKey, dict[str, RunFigure]]:
    """Return the figures of each metric by run; one in several units within a run has no value, and says so."""
    found: dict[MetricKey, dict[str, RunFigure]] = {}
    for figure in figures:
        kept = found.setdefault(figure.key, {})
        kept[figure.run] = figure if figure.run not in kept else _of_several_units(kept[figure.run], figure)
    return found


def clock_notes(lines: Sequence[RunLine]) -> tuple[str, ...]:
    """Name runs by whose times a station's clock must have been wrong; their order is that of their names."""
    notes = []
    for station in sorted({line.station for line in lines}):
        own = [line for line in lines if line.station == station]
        for before, after in pairwise(own):
            back = before.started_at - after.started_at
            if back > _CLOCK_STEP:
                notes.append(
                    f"the clock of {of_kind('station', station)} was wrong by about {_span(back)} at one of two "
                    f"runs: {after.run} came after {before.run}, and says {_day(after)} where that says "
                    f"{_day(before)}; "
                    "runs are in the order they were made in, not in that of the clock"
                )
    return tuple(notes)


def software_note(versions: Mapping[str, str]) -> tuple[str, ...]:
    """Name the versions that runs were analysed with, where they are several: a metric may mean something else."""
    counts = Counter(version or "not noted" for version in versions.values())
    if len(counts) < 2:
        return ()
    said = ", ".join(f"{version} ({plural(count, 'run')})" for version, count in sorted(counts.items()))
    return (f"the runs were analysed with several versions of cbsr-qa: {said}; a change may be the software's",)


def recipe_note(store: Repository, lines: Sequence[RunLine]) -> tuple[str, ...]:
    """Say where the first and the last of some runs were not measured alike, though their recipe has one name."""
    first, last = lines[0], lines[-1]
    if measuring_digest(store.configuration(first.run)) == measuring_digest(store.configuration(last.run)):
        return ()
    return (
        f"recipe {last.recipe}, sensor type, material or head was not the same at the first ({first.run}) and the "
        f"last ({last.run}) of these runs; a change may be theirs",
    )


def _has_limit(figure: RunFigure) -> bool:
    return figure.lower is not None or figure.upper is not None


def _of_several_units(first: RunFigure, second: RunFigure) -> RunFigure:
    units = tuple(sorted({*(first.units or (first.unit,)), second.unit}))
    most = max(first, second, key=lambda one: one.places)
    return replace(most, value=None, places=first.places + second.places, units=units)


def _check_names(names: Sequence[str], known: Iterable[MetricKey]) -> None:
    measured = sorted({key.name for key in known})
    if not measured:
        raise RefusedError("none of these runs has measurements", remedy="choose runs that were finished")
    for name in names:
        if name not in measured:
            remedy = f"{did_you_mean(name, measured)} measured: {', '.join(measured)}".lstrip()
            raise RefusedError(f"no run of these measured {echo(name, 64)}", remedy=remedy)


def _series(key: MetricKey, lines: Sequence[RunLine], figures: Mapping[str, RunFigure]) -> Series:
    there = [(line, figures[line.run]) for line in lines if line.run in figures]
    whole = [figure for _, figure in there if not figure.units] or [figure for _, figure in there]
    unit = _most(figure.unit for figure in whole)
    places = _most(figure.places for figure in whole if figure.unit == unit)
    kept: list[tuple[RunLine, float]] = []
    left: dict[str, list[str]] = {}
    for line in lines:
        figure = figures.get(line.run)
        why = _why_not(figure, unit, places)
        if why:
            left.setdefault(why, []).append(_who(line))
        elif figure is not None and figure.value is not None:
            kept.append((line, figure.value))
    notes = tuple(f"left out: {why}: {named(who)}" for why, who in left.items())
    latest = there[-1][1]
    own = tuple(line for line, _ in kept)
    return Series(key, unit, own, tuple(value for _, value in kept), latest.lower, latest.upper, notes)


def _why_not(figure: RunFigure | None, unit: str, places: int) -> str:
    """Say why a run's figure cannot stand beside the others; empty where it can."""
    if figure is None:
        return "did not measure it"
    if figure.unit != unit and not figure.units:
        return f"in {figure.unit} instead of {unit}"
    if figure.value is None:
        return figure.why
    return "" if figure.places == places else f"the mean of {figure.places} values instead of {places}"


def _most(values: Iterable[_T]) -> _T:
    return Counter(values).most_common(1)[0][0]


def _who(line: RunLine) -> str:
    return f"{line.serial} (run {line.run} on {line.station})"


def _day(line: RunLine) -> str:
    return f"{line.started_at.astimezone(UTC):%Y-%m-%d}"


def _span(span: timedelta) -> str:
    days = span / timedelta(days=1)
    return f"{days / 365.25:.1f} years" if days > 300 else f"{days:.0f} days"
