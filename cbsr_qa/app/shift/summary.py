"""Yield, first-pass yield and reasons for failure of the runs of a selection, such as those of a shift."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, time, timedelta
from typing import Annotated

from pydantic import Field

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import MetricKey, RunSelection
from cbsr_qa.domain.results.listed import ListedRun
from cbsr_qa.stats.process_capability import Yield, pass_rate
from cbsr_qa.store.repository import Repository
from cbsr_qa.studies.selection import BY_OPERATOR


@dataclass(frozen=True, slots=True)
class Tally:
    """Runs counted by how they ended. An overridden verdict counts as it was overridden.

    Parameters
    ----------
    name : name of the station or recipe; empty for all.
    runs : passed + failed + not_measured + not_judged + no_result + not_finished + altered.
    decided : passed + failed.
    passed : number that passed; ``marginal`` of them only just.
    no_result : number of finished runs without an analysis.
    not_finished : number of runs that were aborted, broken, cut off or in progress; their verdicts do not count.
    altered : number of runs whose stored rows do not match their chains; a sensor counts in no yield if its last run
        is one.
    sensors : serial numbers.
    test_yield : share of sensors that passed in their last decided run; a sensor counts once for each recipe. With
        Wilson's interval (95 %); None if nothing was decided.
    first_pass_yield : share of sensors that passed in the first finished run of the recipe on them. Left out are
        sensors whose first finished run is not among these runs, or decided nothing.
    """

    name: str
    runs: int
    decided: int
    passed: int
    marginal: int
    failed: int
    not_measured: int
    not_judged: int
    no_result: int
    not_finished: int
    altered: int
    overridden: int
    sensors: int
    test_yield: Annotated[Yield | None, Field(serialization_alias="yield")]
    first_pass_yield: Yield | None


@dataclass(frozen=True, slots=True)
class FailureReason:
    """A limit that was failed.

    Parameters
    ----------
    limit : name of the metric with phase and qualifier, as recipes write it; empty where an operator decided.
    words : the limit as people say it.
    sensors, runs : numbers of sensors that failed it and of runs that count as failed; one run may fail several
        limits.
    """

    limit: str
    words: str
    sensors: int
    runs: int


@dataclass(frozen=True, slots=True)
class CodeCount:
    """A failure code and what it was given to.

    Parameters
    ----------
    sensors, runs : numbers of sensors and runs with it, but for verdicts overridden to a pass; one run may have
        several.
    """

    code: str
    text: str
    disposition: str
    sensors: int
    runs: int


@dataclass(frozen=True, slots=True)
class ShiftSummary:
    """The runs of a selection, all and by station and recipe; reasons for failure and codes, most sensors first."""

    total: Tally
    stations: tuple[Tally, ...]
    recipes: tuple[Tally, ...]
    reasons: tuple[FailureReason, ...]
    codes: tuple[CodeCount, ...]


def local_day() -> tuple[datetime, datetime]:
    """Return the beginning and the end of today, as this computer reckons days."""
    begins = datetime.combine(datetime.now().astimezone().date(), time())
    return begins.astimezone(), (begins + timedelta(days=1)).astimezone()


def shift_summary(store: Repository, selection: RunSelection) -> ShiftSummary:
    """Summarise stored runs; ``RunSelection(checks=False)`` leaves out runs that checked a station.

    Raises
    ------
    StoreError
        If the database cannot be read; of a damaged run the message names it.
    """
    return summarise_runs(store.lists.read_runs(selection))


def summarise_runs(runs: Sequence[ListedRun]) -> ShiftSummary:
    """Summarise runs that are in the order they were made in; those that checked a station are left out.

    An altered run is counted as altered instead: its outcome is not known.
    """
    runs = [run for run in runs if run.altered or not run.of_check]
    return ShiftSummary(
        _tally("", runs),
        _tally_by(runs, lambda run: run.station),
        _tally_by(runs, lambda run: run.recipe),
        _reasons(runs),
        _count_codes(runs),
    )


def list_failed_limits(run: ListedRun) -> tuple[MetricKey, ...]:
    """Return the limits for which a run counts as failed; none if it does not, or an operator alone decided so."""
    return run.failed if run.verdict is Outcome.FAIL else ()


def select_settled_runs(runs: Sequence[ListedRun]) -> list[ListedRun]:
    """Return the runs that passed or failed, or of which that is not known because they were altered."""
    return [run for run in runs if run.altered or run.passed or run.verdict is Outcome.FAIL]


def _tally_by(runs: Sequence[ListedRun], name: Callable[[ListedRun], str]) -> tuple[Tally, ...]:
    groups: dict[str, list[ListedRun]] = {}
    for run in runs:
        groups.setdefault(name(run), []).append(run)
    return tuple(_tally(group_name, groups[group_name]) for group_name in sorted(groups))


def _tally(name: str, runs: Sequence[ListedRun]) -> Tally:
    altered_count = sum(bool(run.altered) for run in runs)
    count_by_verdict = Counter(run.verdict for run in runs if run.finished and not run.altered)
    passed = count_by_verdict[Outcome.PASS] + count_by_verdict[Outcome.MARGINAL]
    settled = select_settled_runs(runs)
    decided_runs = [run for run in settled if not run.altered]
    last_runs = {(run.serial, run.recipe): run for run in settled}
    first_runs = [run for run in decided_runs if not run.earlier]  # no finished run of the sensor before it
    return Tally(
        name=name,
        runs=len(runs),
        decided=len(decided_runs),
        passed=passed,
        marginal=count_by_verdict[Outcome.MARGINAL],
        failed=count_by_verdict[Outcome.FAIL],
        not_measured=count_by_verdict[Outcome.NOT_MEASURED],
        not_judged=count_by_verdict[Outcome.NOT_JUDGED],
        no_result=count_by_verdict[None],
        not_finished=len(runs) - count_by_verdict.total() - altered_count,
        altered=altered_count,
        overridden=sum(run.finished and run.decision is not None for run in runs),
        sensors=len({run.serial for run in runs}),
        test_yield=_share([run for run in last_runs.values() if not run.altered]),
        first_pass_yield=_share(first_runs),
    )


def _share(runs: Sequence[ListedRun]) -> Yield | None:
    return pass_rate(sum(run.passed for run in runs), len(runs)) if runs else None


def _reasons(runs: Sequence[ListedRun]) -> tuple[FailureReason, ...]:
    serials_by_limit: dict[tuple[str, str], list[str]] = {}
    for run in runs:
        if run.verdict is not Outcome.FAIL:
            continue
        for limit in [(key.label, key.title) for key in list_failed_limits(run)] or [("", BY_OPERATOR)]:
            serials_by_limit.setdefault(limit, []).append(run.serial)
    reasons = [FailureReason(*limit, len(set(serials)), len(serials)) for limit, serials in serials_by_limit.items()]
    return tuple(sorted(reasons, key=lambda reason: (-reason.sensors, -reason.runs, reason.limit)))


def _count_codes(runs: Sequence[ListedRun]) -> tuple[CodeCount, ...]:
    """Count codes; recipes may give one code several meanings, which count apart."""
    serials_by_code: dict[tuple[str, str, str], list[str]] = {}
    for run in runs:
        for code in () if run.passed else run.failure_codes:
            serials_by_code.setdefault((code.code, code.text, code.disposition), []).append(run.serial)
    counts = [CodeCount(*code, len(set(serials)), len(serials)) for code, serials in serials_by_code.items()]
    return tuple(sorted(counts, key=lambda count: (-count.sensors, -count.runs, count.code)))
