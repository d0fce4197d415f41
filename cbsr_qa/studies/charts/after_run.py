"""How a station's charts stand at the end of a run: only those with a stored reference, and only the latest runs."""

from collections.abc import Iterable, Sequence
from typing import Final

from cbsr_qa.domain import NumericsError
from cbsr_qa.domain.results import Bound, Measurement, MetricKey, RunFigure, RunLine
from cbsr_qa.domain.run import ChartKind, ChartReference, RunIdentity, StandingSignal, StationCharts
from cbsr_qa.stats import Standard
from cbsr_qa.store import Repository, RunFilter
from cbsr_qa.studies.charts.charting import charts_of, reference_figures, standing
from cbsr_qa.studies.figure_series import clock_notes, figures_by_run

#: Runs that are looked back; an average or a sum of earlier ones says nothing of today.
LOOK_BACK: Final = 100


def charts_after(
    store: Repository, identity: RunIdentity, measurements: Sequence[Measurement] | None = None, *, until: str = ""
) -> StationCharts | None:
    """Return how the charts of a run's station stand with it, whichever recipe and metric they are of.

    Parameters
    ----------
    measurements : of the run, where no analysis of it is stored yet; None to take what is stored.
    until : leave out references and runs that are later than something of this name, e.g. an analysis.

    Returns
    -------
    None where no reference is stored for the station.
    """
    references = store.chart_references(identity.station, until)
    if not references:
        return None
    own = None if measurements is None else _own(identity.run, measurements)
    signals: list[StandingSignal] = []
    notes: dict[str, None] = {}
    for recipe, golden in dict.fromkeys((one.recipe, one.golden) for one in references):
        members = [one for one in references if (one.recipe, one.golden) == (recipe, golden)]
        lines = _lines(store, identity.station, members, until)
        figures = reference_figures(store, lines, members)
        notes |= dict.fromkeys(clock_notes(lines))
        if own is not None and recipe == identity.recipe and golden in (None, identity.sensor.serial):
            lines, figures = _with_own(lines, figures, identity, own)
        for one in members:
            try:
                signals += filter(None, [_signal(one, lines, figures)])
            except NumericsError as error:
                notes[f"{one.label}: {error.reason}"] = None
    return StationCharts(identity.station, len(references), tuple(signals), tuple(notes))


def _own(run: str, measurements: Iterable[Measurement]) -> dict[MetricKey, RunFigure]:
    """Return the figures of measurements as the store would: of all places together, and of each."""
    groups: dict[tuple[MetricKey, str], list[Measurement]] = {}
    for m in measurements:
        for location in dict.fromkeys(("", m.location)):
            groups.setdefault((MetricKey(m.name, m.phase, m.qualifier, location), m.unit), []).append(m)
    figures = (_figure(run, key, unit, members) for (key, unit), members in groups.items())
    return {key: of[run] for key, of in figures_by_run(figures).items()}


def _figure(run: str, key: MetricKey, unit: str, members: Sequence[Measurement]) -> RunFigure:
    values = [m.value for m in members if m.value is not None]
    missing = len(members) - len(values)
    bounded = sum(m.bound is not Bound.EXACT for m in members)
    mean = None if missing or bounded else sum(values) / len(values)
    return RunFigure(run, key, unit, mean, len(members), missing, bounded)


def _lines(store: Repository, station: str, members: Sequence[ChartReference], until: str) -> tuple[RunLine, ...]:
    """The latest runs of one recipe, of one golden sensor or of production."""
    first = members[0]
    grouped = any(one.chart is ChartKind.MEANS for one in members)
    return store.run_lines(
        RunFilter(
            serials=(first.golden,) if first.golden else (),
            station=station,
            recipe=first.recipe,
            golden=bool(first.golden),
            after=min(one.last_run for one in members),
            until=until,
            latest=None if grouped else LOOK_BACK,  # groups are counted from the end of the reference
        )
    )


def _with_own(
    lines: tuple[RunLine, ...],
    figures: dict[MetricKey, dict[str, RunFigure]],
    identity: RunIdentity,
    own: dict[MetricKey, RunFigure],
) -> tuple[tuple[RunLine, ...], dict[MetricKey, dict[str, RunFigure]]]:
    """Put the run that just ended among the stored ones; one that was resumed has an earlier name than some."""
    named = identity.station, identity.recipe, identity.operator
    line = RunLine(identity.run, identity.sensor.serial, *named, identity.started_at, "")
    others = tuple(one for one in lines if one.run != identity.run)
    for key, figure in own.items():
        figures.setdefault(key, {})[identity.run] = figure
    return tuple(sorted((*others, line), key=lambda each: each.run)), figures


def _signal(
    one: ChartReference, lines: Sequence[RunLine], figures: dict[MetricKey, dict[str, RunFigure]]
) -> StandingSignal | None:
    of = figures.get(one.key, {})
    pairs = [(line, of[line.run].value) for line in lines if line.run in of and line.run > one.last_run]
    kept = [(line, value) for line, value in pairs if value is not None and of[line.run].unit == one.unit]
    if len(kept) < one.subgroup:
        return None
    charts = charts_of([value for _, value in kept], one, Standard(one.mean, one.deviation))
    return standing(charts, [line for line, _ in kept], one, cut=len(lines) >= LOOK_BACK)
