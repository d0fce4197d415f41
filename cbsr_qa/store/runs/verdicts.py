"""What holds of runs: how each ended, its latest result, and the override of that. Read here only, and checked.

Rows of a run, its states, analyses and overrides are compared with their links before anybody sees a verdict.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache, partial
from typing import Any, Final

from sqlalchemy import Connection

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import FailureCode, Outcome, read_failure_codes
from cbsr_qa.domain.results.listed import Decision
from cbsr_qa.domain.run.run import ChainState
from cbsr_qa.domain.run.states import EndReason, ResultState
from cbsr_qa.domain.sensor.sensor_type import SensorPart
from cbsr_qa.store.chain.check import RESTORE, chain_state
from cbsr_qa.store.chain.many_runs import RUNS_AT_ONCE, find_altered, read_rows
from cbsr_qa.store.damage import read_word
from cbsr_qa.store.runs.standing import find_outdated
from cbsr_qa.store.tables.records import VerdictOverrideRow
from cbsr_qa.store.tables.results import AnalysisRow
from cbsr_qa.store.tables.runs import PartRow, RunRow, RunStateRow
from cbsr_qa.store.unreadable_runs import read_apart, readable_values
from cbsr_qa.system.json_text import parse_json

#: Columns of a run that are as long as all others together, and that nobody lists.
_LONG_COLUMNS: Final = ("configuration", "configuration_digest", "software")
#: Columns of a state, an analysis and an override, in the order of what reads them.
_STATE: Final = ("end", "detail", "time_s")
_RESULT: Final = ("analysis", "analysed_at", "outcome", "reason", "software")
_DECISION: Final = ("outcome", "operator", "why")
_ENDS: Final = {str(end): end for end in EndReason}
_SEED: Final = re.compile(r'"seed": ?\d+')
#: Outcomes of analyses that no failure code is for.
_UNCODED: Final = frozenset(map(str, (Outcome.PASS, Outcome.MARGINAL, Outcome.NOT_JUDGED)))
_OUTCOMES: Final = {str(outcome): outcome for outcome in Outcome}


@dataclass(frozen=True, slots=True)
class StoredVerdict:
    """What holds of a run.

    Parameters
    ----------
    values : columns of its row but the longest.
    end, end_detail, station_s : of its last state; RUNNING, empty and 0 without one.
    analysis, analysed_at, outcome, reason, software : of the latest analysis after its last session; empty and None
        without one.
    decision : the latest override of that analysis; None without one.
    altered : what does not match the chain, or cannot be read; nothing else is then known but ``values`` and ``end``
        as they stand, and there is no result. Empty for a sound run, and for an unchained one that can be read, where
        nothing can be compared.
    coded : all failure codes of the run's recipe; not read where its outcome has none.
    parts : parts of its sensor; none where it was altered.
    """

    values: Mapping[str, Any]
    chain: ChainState
    end: EndReason
    end_detail: str
    station_s: float
    analysis: str = ""
    analysed_at: datetime | None = None
    outcome: Outcome | None = None
    reason: str = ""
    software: tuple[tuple[str, str], ...] = ()
    decision: Decision | None = None
    altered: str = ""
    coded: tuple[FailureCode, ...] = ()
    parts: tuple[SensorPart, ...] = ()

    @property
    def run(self) -> str:
        return str(self.values["run"])

    @property
    def result(self) -> ResultState:
        return ResultState.from_end(self.end, analysed=bool(self.analysis))

    def validate(self) -> "StoredVerdict":
        """Return itself. StoreError if the run was altered."""
        if self.altered:
            raise StoreError(self.altered, remedy=RESTORE)
        return self


def verdict_pages(connection: Connection, runs: Sequence[str]) -> Iterator[list[StoredVerdict]]:
    """Yield what holds of runs, given by their names in order, some at a time.

    A run of which a cell cannot be read, or holds an unknown outcome or end, is marked as an altered one is.
    """
    mark_unreadable = partial(_unreadable, connection)
    for first in range(0, len(runs), RUNS_AT_ONCE):
        parts = read_apart(
            connection,
            runs[first : first + RUNS_AT_ONCE],
            lambda batch: list(_list_verdicts(connection, batch)),
            mark_unreadable,
        )
        yield [verdict for part in parts for verdict in part]


def read_verdicts(connection: Connection, runs: Sequence[str]) -> Iterator[StoredVerdict]:
    """Yield what holds of runs, one by one, as :func:`verdict_pages`."""
    for page in verdict_pages(connection, runs):
        yield from page


def verdict_of(connection: Connection, run: str) -> StoredVerdict | None:
    """Return what holds of a run; None if it is not stored."""
    return next(read_verdicts(connection, [run]), None)


def _unreadable(connection: Connection, run: str, problem: str) -> list[StoredVerdict]:
    values = readable_values(connection, run)
    shown_values = {name: value for name, value in values.items() if name not in _LONG_COLUMNS}
    return [
        StoredVerdict(
            shown_values, chain_state(connection, values["chain"]), EndReason.RUNNING, "", 0.0, altered=problem
        )
    ]


def _list_verdicts(connection: Connection, runs: Sequence[str]) -> Iterator[StoredVerdict]:
    tables = RunRow, RunStateRow, AnalysisRow, VerdictOverrideRow, PartRow
    own, states, analyses, overrides, part_rows = tables_read = [
        read_rows(connection, table, runs) for table in tables
    ]
    chains = dict(zip(own.runs, own.columns["chain"], strict=True))
    altered = find_altered(connection, chains, tables_read, ended=True)
    known_chains = {chain: chain_state(connection, chain) for chain in set(chains.values())}
    # Rows are sorted by run and key: the last one of a run holds.
    numbers = zip(states.runs, states.columns["number"], strict=True)
    resumed = {run for run, number in numbers if run not in altered and number > 1}
    outdated = find_outdated(connection, resumed)
    results = zip(analyses.runs, analyses.tuples(_RESULT), strict=True)
    state_of = dict(zip(states.runs, states.tuples(_STATE), strict=True))
    analysis_of = {run: analysis for run, analysis in results if analysis[0] not in outdated}
    places = zip(overrides.runs, overrides.columns["analysis"], strict=True)
    decided = dict(zip(places, overrides.tuples(_DECISION), strict=True))
    parts: dict[str, tuple[SensorPart, ...]] = {}
    for run, cells in zip(part_rows.runs, part_rows.tuples(("name", "identifier", "revision")), strict=True):
        parts[run] = (*parts.get(run, ()), SensorPart(*cells))
    names = [name for name in own.columns if name not in _LONG_COLUMNS]
    for run, configuration, values in zip(own.runs, own.columns["configuration"], own.tuples(names), strict=True):
        facts, chain = dict(zip(names, values, strict=True)), known_chains[chains[run]]
        state, analysis = state_of.get(run), analysis_of.get(run)
        if run in altered:
            end = EndReason.RUNNING if state is None else _ENDS.get(state[0], EndReason.RUNNING)
            yield StoredVerdict(facts, chain, end, "", 0.0, altered=altered[run])
            continue
        if not (isinstance(facts["simulated"], list) and isinstance(facts["setting"], dict)):  # of an unchained run
            raise TypeError("runs.simulated or runs.setting holds JSON of another shape")
        end, detail, station_s = state or (EndReason.RUNNING, "", 0.0)
        end = _ENDS.get(end) or read_word(EndReason, end, "run_states.end", f"run {run}")
        coded = () if analysis and analysis[2] in _UNCODED else _read_failure_codes(configuration)
        verdict = StoredVerdict(facts, chain, end, detail, station_s, coded=coded, parts=parts.get(run, ()))
        yield verdict if analysis is None else _with_result(verdict, analysis, decided.get((run, analysis[0])))


def _read_failure_codes(configuration: str) -> tuple[FailureCode, ...]:
    """Return the codes of a stored recipe. Raise as reading a foreign cell where an unchained run holds others."""
    if '"failure_codes"' not in configuration:
        return ()
    return _parse_failure_codes(reset_seed(configuration))


def reset_seed(configuration: str) -> str:
    """Return a configuration with its seed zero, so that runs of one recipe share it and it is parsed once."""
    return _SEED.sub('"seed":0', configuration)


@lru_cache(maxsize=32)  # thousands of runs differ in their seed only, and parsing takes longer than all else of a run
def _parse_failure_codes(configuration: str) -> tuple[FailureCode, ...]:
    return read_failure_codes(parse_json(configuration)["recipe"].get("failure_codes", {}))


def _with_result(
    verdict: StoredVerdict, analysis: tuple[Any, ...], override: tuple[Any, ...] | None
) -> StoredVerdict:
    name, analysed_at, outcome, reason, software = analysis
    decision = None
    if override is not None:
        decided, operator, why = override
        decided = read_word(Outcome, decided, "verdict_overrides.outcome", f"run {verdict.run}")
        decision = Decision(decided, operator, why)
    return StoredVerdict(
        verdict.values,
        verdict.chain,
        verdict.end,
        verdict.end_detail,
        verdict.station_s,
        name,
        analysed_at,
        _OUTCOMES.get(outcome) or read_word(Outcome, outcome, "analyses.outcome", f"analysis {name}"),
        reason,
        tuple((package, version) for package, version in software),
        decision,
        coded=verdict.coded,
        parts=verdict.parts,
    )
