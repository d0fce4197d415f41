"""Configuration changes noted with each run, and overrides of verdicts. Neither alters earlier rows."""

from collections.abc import Callable, Collection, Sequence
from datetime import datetime
from functools import partial
from typing import Final

from sqlalchemy import ColumnElement, Connection, Engine, and_, or_, select

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.run.changes import (
    ChangeHistory,
    ConfigurationChange,
    Difference,
    FileKind,
    VerdictOverride,
)
from cbsr_qa.domain.run.run import RunIdentity, RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.chain.check import RESTORE, check_run
from cbsr_qa.store.chain.links import add_rows, match_few_links
from cbsr_qa.store.chain.many_runs import RUNS_AT_ONCE, find_altered, read_rows
from cbsr_qa.store.damage import read_word
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.mapping import convert_row
from cbsr_qa.store.results.analyses import analysis_outcome
from cbsr_qa.store.runs.configuration_changes import list_files
from cbsr_qa.store.runs.rows import run_row
from cbsr_qa.store.runs.standing import standing_of
from cbsr_qa.store.runs.verdicts import verdict_of
from cbsr_qa.store.tables.records import ConfigurationChangeRow, LinkRow, VerdictOverrideRow
from cbsr_qa.store.tables.results import AdoptionRow, AnalysisRow, ReanalysisRow
from cbsr_qa.store.tables.runs import Base, RunRow
from cbsr_qa.store.unreadable_runs import read_apart

_ACCEPTED: Final = (str(Outcome.PASS), str(Outcome.MARGINAL))


class Changes:
    """Changed configuration files, and overridden verdicts."""

    def __init__(self, engine: Engine, new_id: Callable[[], str], wall: Callable[[], datetime]) -> None:
        self._engine = engine
        self._new_id = new_id
        self._wall = wall

    def find_altered(self) -> dict[str, str]:
        """Return the problems of records of people's changes and decisions, by run: files, overrides, adoptions.

        Runs that have only links of such records are checked too: their rows may have been removed.
        """
        kinds = ConfigurationChangeRow, VerdictOverrideRow, AdoptionRow, ReanalysisRow, AnalysisRow
        names = [kind.__tablename__ for kind in kinds[:3]]
        with reading(self._engine) as connection:
            linked = select(LinkRow.run).where(LinkRow.kind.in_(names), match_few_links()).distinct()
            runs = {*connection.scalars(linked), *connection.scalars(select(ConfigurationChangeRow.run))}
            runs |= {*connection.scalars(select(VerdictOverrideRow.run))}
            runs |= {
                *connection.scalars(
                    select(AnalysisRow.run).join(AdoptionRow, AdoptionRow.analysis == AnalysisRow.analysis)
                )
            }
            return _find_altered(connection, sorted(runs), kinds)

    def list_all(self, without: Collection[str] = ()) -> tuple[ConfigurationChange, ...]:
        """Return the noted changes of all runs, oldest first, without those of some runs."""
        with reading(self._engine) as connection:
            return _changes(connection, ConfigurationChangeRow.run.not_in(without))

    def read_history(self, record: RunRecord) -> ChangeHistory:
        """Return the changes of a run's files since its sensor type last passed its recipe, including its own.

        Changes noted with altered runs are left out, and named.
        """
        row, identity = ConfigurationChangeRow, record.identity
        named_files = list_files(identity, record.material.name)
        files = or_(*(and_(row.kind == str(kind), row.name == name) for kind, name, _ in named_files))
        with reading(self._engine) as connection:
            since = _last_accepted(connection, identity)
            changes = _changes(connection, files, row.run > since, row.run <= identity.run)
            altered = _find_altered(connection, sorted({change.run for change in changes}), [ConfigurationChangeRow])
        return ChangeHistory(
            since, tuple(change for change in changes if change.run not in altered), tuple(altered.values())
        )

    def override_verdict(self, run: str, outcome: Outcome, *, operator: str, why: str) -> VerdictOverride:
        """Store a decision beside the verdict of a run's latest analysis, which is kept; the latest decision holds.

        Raises
        ------
        StoreError
            If the run does not exist, was altered, has not finished, or has no result yet; nothing is stored then.
        """
        override, noted_at = self._new_id(), self._wall()
        with writing(self._engine) as connection:
            analysis, verdict = _read_verdict(connection, run)
            decision = VerdictOverride(override, run, analysis, verdict, outcome, operator, noted_at, why)
            values = {"run": run, "analysis": analysis, "outcome": str(outcome), "operator": operator, "why": why}
            row = {"override_id": override, "noted_at": noted_at, **values}
            add_rows(connection, run, VerdictOverrideRow, [row])
        return decision

    def list_overrides(self, run: str | None = None, *, without: Collection[str] = ()) -> tuple[VerdictOverride, ...]:
        """Return the overrides of one run's verdicts, or of all but some, oldest first.

        StoreError if the run was altered. Without ``run``, :meth:`find_altered` names altered runs.
        """
        row = VerdictOverrideRow
        query = select(*row.__table__.columns, AnalysisRow.outcome.label("verdict")).join(
            AnalysisRow, AnalysisRow.analysis == row.analysis
        )
        query = query.where(row.run.not_in(without) if run is None else row.run == run)
        with reading(self._engine) as connection:
            altered = {} if run is None else _find_altered(connection, [run], [VerdictOverrideRow, AnalysisRow])
            for problem in altered.values():
                raise StoreError(problem, remedy=RESTORE)
            rows = connection.execute(query.order_by(row.override_id)).all()
        return tuple(
            VerdictOverride(
                decision.override_id,
                decision.run,
                decision.analysis,
                read_word(Outcome, decision.verdict, "analyses.outcome", f"analysis {decision.analysis}"),
                read_word(Outcome, decision.outcome, "verdict_overrides.outcome", f"override {decision.override_id}"),
                decision.operator,
                decision.noted_at,
                decision.why,
            )
            for decision in rows
        )


def _find_altered(connection: Connection, runs: Sequence[str], kinds: Sequence[type[Base]]) -> dict[str, str]:
    problem_by_run: dict[str, str] = {}
    for start in range(0, len(runs), RUNS_AT_ONCE):
        batch = runs[start : start + RUNS_AT_ONCE]
        read_page = partial(_find_altered_page, connection, kinds)
        for altered in read_apart(connection, batch, read_page, lambda run, problem: {run: problem}):
            problem_by_run |= altered
    return problem_by_run


def _find_altered_page(connection: Connection, kinds: Sequence[type[Base]], runs: Sequence[str]) -> dict[str, str]:
    rows = connection.execute(select(RunRow.run, RunRow.chain).where(RunRow.run.in_(runs)))
    chains = {row.run: row.chain for row in rows}
    records_of_kinds = [read_rows(connection, kind, runs) for kind in kinds]
    for records in records_of_kinds:
        for word in records.columns.get("outcome", ()):
            # The error names the run once it is alone in its batch.
            read_word(Outcome, word, f"{records.table.name}.outcome", f"run {runs[0]}")
    return find_altered(connection, chains, records_of_kinds, ended=True)


def _last_accepted(connection: Connection, identity: RunIdentity) -> str:
    """Return the latest earlier run of the sensor type and recipe that passed and was not altered; may be empty."""
    # Overrides do not count: a run passed by hand shows that its recipe is not accepted yet.
    passed_query = (
        select(RunRow.run)
        .join(AnalysisRow, AnalysisRow.run == RunRow.run)
        .where(RunRow.sensor_type == identity.sensor.sensor_type, RunRow.recipe == identity.recipe)
        .where(RunRow.run < identity.run, AnalysisRow.outcome.in_(_ACCEPTED))
    )
    for run in connection.scalars(passed_query.distinct().order_by(RunRow.run.desc())).all():
        verdict = verdict_of(connection, run)
        if verdict is not None and verdict.outcome in _ACCEPTED:
            return run
    return ""


def _changes(connection: Connection, *conditions: ColumnElement[bool]) -> tuple[ConfigurationChange, ...]:
    row = ConfigurationChangeRow
    query = select(*row.__table__.columns).where(*conditions).order_by(row.run, row.kind)
    return tuple(
        convert_row(
            ConfigurationChange,
            note,
            kind=read_word(FileKind, note.kind, "configuration_changes.kind", f"run {note.run}"),
            old_digest=note.old_sha256,
            new_digest=note.new_sha256,
            differences=tuple(Difference(*cells) for cells in note.differences),
            by=note.operator,
            at=note.noted_at,
        )
        for note in connection.execute(query)
    )


def _read_verdict(connection: Connection, run: str) -> tuple[str, Outcome]:
    if run_row(connection, run) is None:
        raise StoreError(f"there is no run {run}", remedy="cbsr-qa report SERIAL names the latest run of a sensor")
    check_run(connection, run)
    standing = standing_of(connection, run)
    if standing.end is not EndReason.FINISHED:
        raise StoreError(
            f"run {run} has not finished ({standing.end}): there is no verdict to override",
            remedy=f"cbsr-qa run --resume {run} continues it",
        )
    if standing.analysis is None:
        raise StoreError(
            f"run {run} has no result yet: there is no verdict to override",
            remedy=f"cbsr-qa run --resume {run} computes it",
        )
    query = select(AnalysisRow.analysis, AnalysisRow.outcome).where(AnalysisRow.analysis == standing.analysis)
    analysis_row = connection.execute(query).one()
    return analysis_row.analysis, analysis_outcome(analysis_row)
