"""Configuration changes noted with each run, and overrides of verdicts. Neither alters earlier rows."""

import hashlib
import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from datetime import datetime
from functools import partial
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, Engine, and_, or_, select

from cbsr_qa.domain import StoreError
from cbsr_qa.domain.results import EndReason, Outcome
from cbsr_qa.domain.run import (
    NO_REASON,
    ChangeHistory,
    ConfigurationChange,
    Difference,
    FileKind,
    RunIdentity,
    VerdictOverride,
    differences,
)
from cbsr_qa.store.apart import read_apart
from cbsr_qa.store.chain import RESTORE, RUNS_AT_ONCE, add_rows, altered_runs, check_run, few_links, read_rows
from cbsr_qa.store.damage import stored
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.mapping import of_row
from cbsr_qa.store.results import analysis_outcome
from cbsr_qa.store.runs import run_row
from cbsr_qa.store.standing import standing_of
from cbsr_qa.store.tables import (
    AdoptionRow,
    AnalysisRow,
    Base,
    ConfigurationChangeRow,
    LinkRow,
    ReanalysisRow,
    RunRow,
    VerdictOverrideRow,
)
from cbsr_qa.store.verdicts import verdict_of

_ACCEPTED: Final = (str(Outcome.PASS), str(Outcome.MARGINAL))


def note_changes(connection: Connection, identity: RunIdentity, configuration: str, material: str, why: str) -> None:
    """Note where a new run's files differ from those of the latest run with the same names.

    Parameters
    ----------
    configuration : canonical JSON of the run.
    material : its name.
    why : in the operator's words; may be empty.
    """
    now = json.loads(configuration)
    rows = []
    for kind, name, names in _names(identity, material):
        new = _content(now, kind)
        earlier = select(RunRow.run, RunRow.configuration).where(names, RunRow.run < identity.run)
        found = connection.execute(earlier.order_by(RunRow.run.desc()).limit(1)).one_or_none()
        if found is None:
            continue
        old = _content(json.loads(found.configuration), kind)
        changed = differences(old, new)
        if changed:
            rows.append(
                {
                    "run": identity.run,
                    "kind": str(kind),
                    "name": name,
                    "earlier_run": found.run,
                    "old_sha256": _digest(old),
                    "new_sha256": _digest(new),
                    "differences": [[one.key, one.before, one.after] for one in changed],
                    "operator": identity.operator,
                    "noted_at": identity.started_at,
                    "why": why or NO_REASON,
                }
            )
    add_rows(connection, identity.run, ConfigurationChangeRow, rows)


def altered_records(engine: Engine) -> dict[str, str]:
    """Return what is wrong with what people changed or decided, by run: notes of files, overrides and adoptions.

    Runs that have only links of such records are looked at too: their rows may have been removed.
    """
    kinds = ConfigurationChangeRow, VerdictOverrideRow, AdoptionRow, ReanalysisRow, AnalysisRow
    names = [one.__tablename__ for one in kinds[:3]]
    with reading(engine) as connection:
        linked = select(LinkRow.run).where(LinkRow.kind.in_(names), few_links()).distinct()
        runs = {*connection.scalars(linked), *connection.scalars(select(ConfigurationChangeRow.run))}
        runs |= {*connection.scalars(select(VerdictOverrideRow.run))}
        runs |= {
            *connection.scalars(
                select(AnalysisRow.run).join(AdoptionRow, AdoptionRow.analysis == AnalysisRow.analysis)
            )
        }
        return _altered(connection, sorted(runs), kinds)


def _altered(connection: Connection, runs: Sequence[str], kinds: Sequence[type[Base]]) -> dict[str, str]:
    found: dict[str, str] = {}
    for first in range(0, len(runs), RUNS_AT_ONCE):
        some = runs[first : first + RUNS_AT_ONCE]
        read = partial(_altered_at_once, connection, kinds)
        for altered in read_apart(connection, some, read, lambda run, problem: {run: problem}):
            found |= altered
    return found


def _altered_at_once(connection: Connection, kinds: Sequence[type[Base]], runs: Sequence[str]) -> dict[str, str]:
    rows = connection.execute(select(RunRow.run, RunRow.chain).where(RunRow.run.in_(runs)))
    chains = {row.run: row.chain for row in rows}
    read = [read_rows(connection, kind, runs) for kind in kinds]
    for one in read:
        for word in one.columns.get("outcome", ()):
            stored(Outcome, word, f"{one.table.name}.outcome", f"run {runs[0]}")  # named once it is alone
    return altered_runs(connection, chains, read, ended=True)


def all_changes(engine: Engine, without: Collection[str] = ()) -> tuple[ConfigurationChange, ...]:
    """Return the noted changes of all runs, oldest first, without those of some, as :func:`altered_records` gives."""
    with reading(engine) as connection:
        return _changes(connection, ConfigurationChangeRow.run.not_in(without))


def history_of(engine: Engine, identity: RunIdentity, material: str) -> ChangeHistory:
    """Return the changes of a run's files since its sensor type last passed its recipe, including its own.

    Changes noted with other runs are left out, and named, where these were altered.
    """
    row = ConfigurationChangeRow
    files = or_(*(and_(row.kind == str(kind), row.name == name) for kind, name, _ in _names(identity, material)))
    with reading(engine) as connection:
        since = _last_accepted(connection, identity)
        changes = _changes(connection, files, row.run > since, row.run <= identity.run)
        altered = _altered(connection, sorted({change.run for change in changes}), [ConfigurationChangeRow])
    return ChangeHistory(
        since, tuple(change for change in changes if change.run not in altered), tuple(altered.values())
    )


def _last_accepted(connection: Connection, identity: RunIdentity) -> str:
    """Return the latest earlier run of the sensor type and recipe that passed and was not altered; may be empty."""
    # Overrides do not count: a run passed by hand shows that its recipe is not accepted yet.
    passed = (
        select(RunRow.run)
        .join(AnalysisRow, AnalysisRow.run == RunRow.run)
        .where(RunRow.sensor_type == identity.sensor.sensor_type, RunRow.recipe == identity.recipe)
        .where(RunRow.run < identity.run, AnalysisRow.outcome.in_(_ACCEPTED))
    )
    for run in connection.scalars(passed.distinct().order_by(RunRow.run.desc())).all():
        found = verdict_of(connection, run)
        if found is not None and found.outcome in _ACCEPTED:
            return run
    return ""


def _changes(connection: Connection, *wanted: ColumnElement[bool]) -> tuple[ConfigurationChange, ...]:
    row = ConfigurationChangeRow
    query = select(*row.__table__.columns).where(*wanted).order_by(row.run, row.kind)
    return tuple(
        of_row(
            ConfigurationChange,
            found,
            kind=stored(FileKind, found.kind, "configuration_changes.kind", f"run {found.run}"),
            old_digest=found.old_sha256,
            new_digest=found.new_sha256,
            differences=tuple(Difference(*one) for one in found.differences),
            by=found.operator,
            at=found.noted_at,
        )
        for found in connection.execute(query)
    )


def _names(identity: RunIdentity, material: str) -> Iterator[tuple[FileKind, str, ColumnElement[bool]]]:
    """Yield kind and name of a run's files, and the condition for other runs that use a file of that name."""
    yield FileKind.RECIPE, identity.recipe, RunRow.recipe == identity.recipe
    yield FileKind.STATION, identity.station, RunRow.station == identity.station
    sensor_type = identity.sensor.sensor_type
    yield FileKind.SENSOR_TYPE, sensor_type, RunRow.sensor_type == sensor_type
    yield FileKind.MATERIAL, material, RunRow.setting["material"]["name"].as_string() == material


def _content(configuration: Mapping[str, Any], kind: FileKind) -> dict[str, Any]:
    """Return a run's configuration of one file; for a station, with its scenes."""
    content = dict(configuration.get(kind.value.replace(" ", "_"), {}))
    if kind is FileKind.STATION:
        content |= {key: configuration[key] for key in ("scenes", "emulated_scene") if configuration.get(key)}
    return content


def _digest(content: Mapping[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def save_override(
    engine: Engine, run: str, outcome: Outcome, *, override: str, operator: str, why: str, noted_at: datetime
) -> VerdictOverride:
    """Store a decision against the verdict of a run's latest analysis.

    Parameters
    ----------
    override : new time-ordered identifier; the latest override of an analysis holds.

    Raises
    ------
    StoreError
        If the run does not exist, was altered, has not finished, or has no result yet; nothing is stored then.
    """
    with writing(engine) as connection:
        analysis, verdict = _judged(connection, run)
        made = VerdictOverride(override, run, analysis, verdict, outcome, operator, noted_at, why)
        values = {"run": run, "analysis": analysis, "outcome": str(outcome), "operator": operator, "why": why}
        row = {"override_id": override, "noted_at": noted_at, **values}
        add_rows(connection, run, VerdictOverrideRow, [row])
    return made


def overrides(
    engine: Engine, run: str | None = None, *, without: Collection[str] = ()
) -> tuple[VerdictOverride, ...]:
    """Return the overrides of one run's verdicts, or of all but some, oldest first.

    StoreError if the run was altered; of all runs, :func:`altered_records` says which not to believe.
    """
    row = VerdictOverrideRow
    query = select(*row.__table__.columns, AnalysisRow.outcome.label("verdict")).join(
        AnalysisRow, AnalysisRow.analysis == row.analysis
    )
    query = query.where(row.run.not_in(without) if run is None else row.run == run)
    with reading(engine) as connection:
        altered = {} if run is None else _altered(connection, [run], [VerdictOverrideRow, AnalysisRow])
        for problem in altered.values():
            raise StoreError(problem, remedy=RESTORE)
        found = connection.execute(query.order_by(row.override_id)).all()
    return tuple(
        VerdictOverride(
            one.override_id,
            one.run,
            one.analysis,
            stored(Outcome, one.verdict, "analyses.outcome", f"analysis {one.analysis}"),
            stored(Outcome, one.outcome, "verdict_overrides.outcome", f"override {one.override_id}"),
            one.operator,
            one.noted_at,
            one.why,
        )
        for one in found
    )


def _judged(connection: Connection, run: str) -> tuple[str, Outcome]:
    if run_row(connection, run) is None:
        raise StoreError(f"there is no run {run}", remedy="cbsr-qa report SERIAL names the latest run of a sensor")
    check_run(connection, run)
    now = standing_of(connection, run)
    if now.end is not EndReason.FINISHED:
        raise StoreError(
            f"run {run} has not finished ({now.end}): there is no verdict to override",
            remedy=f"cbsr-qa run --resume {run} continues it",
        )
    if now.analysis is None:
        raise StoreError(
            f"run {run} has no result yet: there is no verdict to override",
            remedy=f"cbsr-qa run --resume {run} computes it",
        )
    query = select(AnalysisRow.analysis, AnalysisRow.outcome).where(AnalysisRow.analysis == now.analysis)
    found = connection.execute(query).one()
    return found.analysis, analysis_outcome(found)
