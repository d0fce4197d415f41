"""Signals of a station's control charts with a stored reference."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.plan.limits import Bound, Outcome
from cbsr_qa.domain.results.charts import ChartKind, ChartReference, StandingSignal, StationCharts
from cbsr_qa.domain.results.fleet import FleetTable, MetricKey, RunFigure, RunLine, RunSelection, State, ValueKind
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.run.run import RunIdentity
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.stats.control_charts import Standard
from cbsr_qa.store.repository import Repository
from cbsr_qa.studies.charts.charting import charts_of, reference_figures, standing
from cbsr_qa.studies.selection import clock_notes

#: Number of latest runs; an average or a sum of earlier ones does not describe the present.
LOOK_BACK: Final = 100


def find_chart_signals(
    store: Repository,
    station: str,
    references: Sequence[ChartReference],
    identity: RunIdentity | None,
    measurements: Sequence[Measurement],
    *,
    until: str,
) -> StationCharts:
    """Return the state of the charts with these references; see :func:`cbsr_qa.app.station_charts.charts_after`."""
    signals: list[StandingSignal] = []
    notes: dict[str, None] = {}
    for recipe, golden in dict.fromkeys((reference.recipe, reference.golden) for reference in references):
        members = [member for member in references if (member.recipe, member.golden) == (recipe, golden)]
        selection = _select_chart_runs(station, members, until)
        table = store.fleet.load_table(selection)
        cut = selection.latest is not None and len(table.runs) >= selection.latest
        figures = reference_figures(table, members)
        lines = tuple(run for run in table.runs if run.outcome is not None)
        notes |= dict.fromkeys(clock_notes(lines))
        if identity is not None and recipe == identity.recipe and golden in (None, identity.sensor.serial):
            own_table = _build_table(identity, measurements)
            for key, figure_by_run in reference_figures(own_table, members).items():
                figures.setdefault(key, {}).update(figure_by_run)
            # A resumed run may sort before later ones.
            other_runs = (run for run in lines if run.run != identity.run)
            lines = tuple(sorted((*other_runs, *own_table.runs), key=lambda run: run.run))
        for reference in members:
            try:
                signal = _find_signal(reference, lines, figures, cut=cut)
            except NumericsError as error:
                notes[f"{reference.label}: {error.reason}"] = None
                continue
            if signal is not None:
                signals.append(signal)
    return StationCharts(station, len(references), tuple(signals), tuple(notes))


def _build_table(identity: RunIdentity, measurements: Sequence[Measurement]) -> FleetTable:
    """Return measurements of a run in the form of the store, which does not hold them yet."""
    line = fill_from_object(
        RunLine,
        identity,
        serial=identity.sensor.serial,
        batch=identity.sensor.batch,
        material="",
        made_at=None,
        end=EndReason.FINISHED,
        outcome=Outcome.NOT_JUDGED,
        software=(),
    )
    count = len(measurements)
    return FleetTable(
        runs=(line,),
        kinds=tuple(
            ValueKind(MetricKey(m.name, m.phase, m.qualifier), m.unit, m.location, None, None) for m in measurements
        ),
        run=np.zeros(count, dtype=np.int32),
        kind=np.arange(count, dtype=np.int32),
        value=np.array([m.value for m in measurements], dtype=np.float64),
        state=np.array(
            [State.PLAIN if m.bound is Bound.EXACT else State.LOWER_BOUND for m in measurements], dtype=np.uint8
        ),
    )


def _select_chart_runs(station: str, members: Sequence[ChartReference], until: str) -> RunSelection:
    """Select the latest runs of one recipe, of one golden sensor or of production."""
    first_member = members[0]
    grouped = any(member.chart is ChartKind.MEANS for member in members)
    return RunSelection(
        serials=(first_member.golden,) if first_member.golden else (),
        stations=(station,),
        recipe=first_member.recipe,
        checks=bool(first_member.golden),
        after=min(reference.last_run for reference in members),
        up_to=until,
        latest=None if grouped else LOOK_BACK,  # groups are counted from the end of the reference
    )


def _find_signal(
    reference: ChartReference,
    lines: Sequence[RunLine],
    figures: dict[MetricKey, dict[str, RunFigure]],
    *,
    cut: bool,
) -> StandingSignal | None:
    figure_by_run = figures.get(reference.key, {})
    later = [line for line in lines if line.run in figure_by_run and line.run > reference.last_run]
    pairs = [(line, figure_by_run[line.run]) for line in later]
    charted = [
        (line, measurement.value)
        for line, measurement in pairs
        if measurement.value is not None and measurement.unit == reference.unit
    ]
    if len(charted) < reference.subgroup:
        return None
    charts = charts_of([value for _, value in charted], reference, Standard(reference.mean, reference.deviation))
    return standing(charts, [line for line, _ in charted], reference, cut=cut)
