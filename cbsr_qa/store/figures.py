"""Values of many runs: selection of runs, and the metrics of their latest analyses."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Engine, Select, case, func, literal, select

from cbsr_qa.domain.results import Bound, MetricKey, RunFigure, RunLine
from cbsr_qa.store.chain import check_analyses
from cbsr_qa.store.engine import reading
from cbsr_qa.store.tables import AnalysisRow, MeasurementRow, RunRow, StationCheckRow

#: Analyses asked for in one query; SQLite before 3.32 takes 999 parameters.
_AT_ONCE: Final = 900


@dataclass(frozen=True, slots=True)
class RunFilter:
    """Selection of analysed runs; all given criteria must hold.

    Parameters
    ----------
    serials : sensors; none for any.
    station, recipe : names; None for any.
    golden : False leaves out the runs of golden sensors that belong to checks of stations.
    after, until : runs whose names sort after the one and not after the other; empty for no bound.
    latest : only so many of the latest; None for all.
    """

    serials: tuple[str, ...] = ()
    station: str | None = None
    recipe: str | None = None
    golden: bool = True
    after: str = ""
    until: str = ""
    latest: int | None = None


def run_lines(engine: Engine, wanted: RunFilter) -> tuple[RunLine, ...]:
    """Return the selected analysed runs, ordered by name, the oldest first."""
    with reading(engine) as connection:
        rows = connection.execute(_query(wanted)).all()
    return tuple(RunLine(*row) for row in reversed(rows) if row.analysis is not None)


def run_figures(
    engine: Engine, lines: Sequence[RunLine], names: Sequence[str] = (), *, by_location: bool = False
) -> tuple[RunFigure, ...]:
    """Return the figures of runs: the mean of each metric over its loads, or over those of each location.

    Parameters
    ----------
    lines : of the runs.
    names : of measurements; none for all.

    Raises
    ------
    StoreError
        If a chained run, or a measurement of it, is not what was stored.
    """
    runs = {line.analysis: line.run for line in lines}
    found: list[RunFigure] = []
    keys: dict[tuple[str, ...], MetricKey] = {}
    with reading(engine) as connection:
        for some in _portions(list(runs)):
            check_analyses(connection, some)
            rows = connection.execute(_figures_query(some, names, by_location))
            found += [_figure(runs, keys, row) for row in rows]
    return tuple(found)


def software_of(engine: Engine, lines: Sequence[RunLine]) -> dict[str, str]:
    """Return run → program version of its latest analysis; empty if none is noted."""
    runs = {line.analysis: line.run for line in lines}
    found: dict[str, str] = {}
    with reading(engine) as connection:
        for some in _portions(list(runs)):
            query = select(AnalysisRow.analysis, AnalysisRow.software).where(AnalysisRow.analysis.in_(some))
            for analysis, software in connection.execute(query):
                found[runs[analysis]] = dict(software).get("cbsr-qa", "")
    return found


def _query(wanted: RunFilter) -> Select[Any]:
    latest = select(func.max(AnalysisRow.analysis)).where(AnalysisRow.run == RunRow.run).scalar_subquery()
    own = (RunRow.run, RunRow.serial, RunRow.station, RunRow.recipe, RunRow.operator, RunRow.started_at)
    query = select(*own, latest.label("analysis")).order_by(RunRow.run.desc())
    if wanted.serials:
        query = query.where(RunRow.serial.in_(wanted.serials))
    for column, value in ((RunRow.station, wanted.station), (RunRow.recipe, wanted.recipe)):
        query = query if value is None else query.where(column == value)
    if wanted.after:
        query = query.where(RunRow.run > wanted.after)
    if wanted.until:
        query = query.where(RunRow.run <= wanted.until)
    if not wanted.golden:
        of_checks = select(StationCheckRow.golden_run).where(StationCheckRow.golden_run.is_not(None))
        query = query.where(RunRow.run.not_in(of_checks))
    return query if wanted.latest is None else query.limit(wanted.latest)


def _figures_query(analyses: Sequence[str], names: Sequence[str], by_location: bool) -> Select[Any]:
    row = MeasurementRow
    key: list[Any] = [row.analysis, row.name, row.phase, row.qualifier, row.unit]
    if by_location:
        key.append(row.location)
    bounded = func.sum(case((row.bound == str(Bound.EXACT), 0), else_=1))
    taken = (
        func.avg(row.value).label("mean"),
        func.count().label("places"),
        func.count(row.value).label("valued"),
        bounded.label("bounded"),
        func.max(row.lower_limit).label("lower"),
        func.min(row.upper_limit).label("upper"),
    )
    location = row.location if by_location else literal("")
    query = select(*key[:5], location, *taken).where(row.analysis.in_(analyses)).group_by(*key).order_by(*key)
    # As an expression, so that no database walks the index of names: it goes through every run there is.
    return query.where(row.name.concat("").in_(names)) if names else query


def _figure(runs: Mapping[str, str], keys: dict[tuple[str, ...], MetricKey], row: Any) -> RunFigure:
    # Taken apart at once: columns by their names take three times as long, and there are many rows.
    analysis, name, phase, qualifier, unit, location, mean, places, valued, bounded, lower, upper = row
    named = (name, phase, qualifier, location)
    key = keys.get(named) or keys.setdefault(named, MetricKey(*named))
    missing, bounded = places - valued, int(bounded)
    value = None if missing or bounded else float(mean)
    return RunFigure(runs[analysis], key, unit, value, places, missing, bounded, lower, upper)


def _portions(names: list[str]) -> Iterator[list[str]]:
    for begin in range(0, len(names), _AT_ONCE):
        yield names[begin : begin + _AT_ONCE]
