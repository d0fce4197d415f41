"""The outcome of ``cbsr-qa gate``: every answer, without running."""

from dataclasses import dataclass

from cbsr_qa.app.gate.gate import gate_refusal
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.results.report import Banner, CommandOutcome, Page, Section
from cbsr_qa.domain.run.gate import GateAnswer, GateOutcome
from cbsr_qa.report.document import Refusal
from cbsr_qa.report.station import gate_table


@dataclass(frozen=True, slots=True)
class GateShown:
    """Answers of the gate to a run that was not made.

    ``asks_pin``: whether the run asks for the operator's PIN. ``refused`` is None if it could begin.
    """

    serial: str
    station: str
    recipe: str
    asks_pin: bool
    answers: tuple[GateAnswer, ...]
    refused: Refusal | None


def gate_outcome(
    serial: str, station: str, recipe: str, answers: tuple[GateAnswer, ...], *, asks_pin: bool
) -> CommandOutcome[GateShown]:
    """Lay out the answers; the exit code is 2 if the run would be refused."""
    error = gate_refusal(answers)
    refusal = None if error is None else fill_from_object(Refusal, error)
    banner = Banner("pass", "✓", "The gate lets this run begin", f"{serial} with {recipe} on {station}")
    if refusal is not None:
        names = ", ".join(str(answer.check) for answer in answers if answer.outcome is GateOutcome.REFUSED)
        banner = Banner("fail", "✗", "The gate refuses this run", f"{names}: {serial} with {recipe} on {station}")
    todo = tuple((str(answer.check), answer.instruction) for answer in answers if answer.remedy)
    page = Page("Gate", serial, banner, todo)
    result = GateShown(serial, station, recipe, asks_pin, answers, refusal)
    return CommandOutcome(result, page, (Section("Answers", (gate_table("", answers),)),), 0 if error is None else 2)
