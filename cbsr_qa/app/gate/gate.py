"""The gate: asks every check of a station before a run, and refuses the run where one refuses."""

from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import nullcontext
from typing import Final

from cbsr_qa.app.gate.disk import enough_disk
from cbsr_qa.app.gate.people import operator_known
from cbsr_qa.app.gate.request import Asked, Finding, GateRequest
from cbsr_qa.app.gate.sensor import parts_unused, retest_allowed, serial_fits
from cbsr_qa.app.gate.station_state import (
    backlog_sent,
    charts_in_control,
    files_released,
    golden_measured,
    instruments_in_date,
)
from cbsr_qa.app.gate.vetoes import plugins_agree
from cbsr_qa.config.merging import Configuration
from cbsr_qa.domain.errors import AT_COMMAND_LINE, CbsrError, RefusedError
from cbsr_qa.domain.plan.gate import GateCheck, GatePolicy
from cbsr_qa.domain.run.gate import GateAnswer, GateOutcome
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.store.opening import open_existing
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.clock import RealClock

CHECKS: Final[Mapping[GateCheck, Callable[[Asked], Finding]]] = {
    GateCheck.SERIAL_PATTERN: serial_fits,
    GateCheck.RETEST: retest_allowed,
    GateCheck.PARTS: parts_unused,
    GateCheck.CALIBRATION_DUE: instruments_in_date,
    GateCheck.GOLDEN: golden_measured,
    GateCheck.CHARTS: charts_in_control,
    GateCheck.DISK: enough_disk,
    GateCheck.OPERATOR: operator_known,
    GateCheck.RELEASED: files_released,
    GateCheck.BACKLOG: backlog_sent,
    GateCheck.BEFORE_RUN: plugins_agree,
}
#: Checks that are asked again when a run is resumed: their answers may have changed and matter for its rest. Others
#: decide whether a run may begin, and this one has begun.
ASKED_AGAIN: Final = frozenset({GateCheck.CALIBRATION_DUE, GateCheck.DISK, GateCheck.OPERATOR})
#: A golden sensor is run again and again, also while the station is out of control, to find out about the station.
_NOT_OF_GOLDEN: Final = frozenset({GateCheck.RETEST, GateCheck.GOLDEN, GateCheck.CHARTS})
_GOLDEN: Final = "not asked of the golden sensor in a check of the station"


def ask_gate(
    request: GateRequest,
    configuration: Configuration,
    plugins: Plugins,
    store: Repository | None,
    checks: Collection[GateCheck] = tuple(GateCheck),
) -> tuple[GateAnswer, ...]:
    """Return the answer of every check, in order; nothing is moved or written.

    A check that cannot be answered, e.g. because a stored run was altered, has not passed.

    Parameters
    ----------
    store : None if there is no database yet.
    checks : checks to ask.
    """
    asked = Asked(request, configuration, plugins, store, RealClock().wall())
    return tuple(_answer(check, asked) for check in GateCheck if check in checks)


def ask_before(request: GateRequest, configuration: Configuration, plugins: Plugins) -> tuple[GateAnswer, ...]:
    """Return the answers as :func:`ask_gate`, by the database of the request as far as it exists."""
    with open_existing(request.database) or nullcontext() as store:
        return ask_gate(request, configuration, plugins, store)


def ask_gate_again(
    answers: Iterable[GateAnswer],
    checks: Collection[GateCheck],
    request: GateRequest,
    configuration: Configuration,
    plugins: Plugins,
    store: Repository,
) -> tuple[GateAnswer, ...]:
    """Return answers with those of some checks as they are now. Raise RefusedError if one of them refuses."""
    answer_by_check = {answer.check: answer for answer in ask_gate(request, configuration, plugins, store, checks)}
    if (refused := gate_refusal(answer_by_check.values())) is not None:
        raise refused
    return tuple(answer_by_check.get(answer.check, answer) for answer in answers)


def gate_refusal(answers: Iterable[GateAnswer]) -> RefusedError | None:
    """Return the one error for all checks that refuse; None if none does."""
    refused_answers = [answer for answer in answers if answer.outcome is GateOutcome.REFUSED]
    if not refused_answers:
        return None
    refused_lines = "\n".join(f"  {answer.check}: {answer.words}" for answer in refused_answers)
    remedies = [
        f"{answer.check}: {answer.remedy}" + (f"\n{AT_COMMAND_LINE}{answer.command}" if answer.command else "")
        for answer in refused_answers
        if answer.remedy
    ]
    names = " ".join(f"--override {answer.check}" for answer in refused_answers)
    override = f"{AT_COMMAND_LINE}override by {names} --override-by NAME --override-why TEXT"
    return RefusedError(
        f"the gate of this station refuses the run:\n{refused_lines}", remedy="\n".join([*remedies, override])
    )


def _answer(check: GateCheck, asked: Asked) -> GateAnswer:
    policy = asked.settings.policy(check)
    finding = Finding(None, "")
    if policy is not GatePolicy.OFF:
        finding = _finding(check, asked)
    if finding.well is None:
        return GateAnswer(check, policy, GateOutcome.OFF, finding.words)
    if finding.well:
        return GateAnswer(check, policy, GateOutcome.PASSED, finding.words)
    codes = [code.words for code in asked.configuration.recipe.failure_codes if check in code.causes]
    finding = finding._replace(words="; ".join([finding.words, *codes]))
    if policy is GatePolicy.WARN:
        return GateAnswer(check, policy, GateOutcome.WARNED, finding.words, finding.remedy, command=finding.command)
    override = asked.request.override
    if check in override.checks:
        operator, reason = override.by, override.why.strip()
        return GateAnswer(check, policy, GateOutcome.OVERRIDDEN, finding.words, finding.remedy, operator, reason)
    return GateAnswer(check, policy, GateOutcome.REFUSED, finding.words, finding.remedy, command=finding.command)


def _finding(check: GateCheck, asked: Asked) -> Finding:
    if asked.request.golden and check in _NOT_OF_GOLDEN:
        return Finding(None, _GOLDEN)
    try:
        return CHECKS[check](asked)
    except CbsrError as error:
        return Finding(False, f"it could not be checked: {error.reason}", error.remedy)
