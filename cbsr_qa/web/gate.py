"""What the gate says of a sensor before its run, as the page shows it."""

from dataclasses import dataclass

from cbsr_qa.app.run import RunRequest, preview_gate
from cbsr_qa.domain.run import GateAnswer, GateOutcome
from cbsr_qa.web.start import StartForm
from cbsr_qa.web.stations import ServedStation


@dataclass(frozen=True, slots=True)
class GateView:
    """Answers that say more than that all is well, and whether the run may begin."""

    may: bool
    answers: tuple[GateAnswer, ...]


def gate_view(served: ServedStation, wanted: StartForm, database: str | None) -> GateView:
    """Ask the gate; the run's process asks again. RefusedError if a file, a folder or the database is wrong."""
    request = RunRequest(
        station=served.source,
        recipe=wanted.recipe.source,
        serial=wanted.serial,
        batch=wanted.batch,
        operator=wanted.operator,
        database=database,
        override=wanted.override,
    )
    shown = preview_gate(request).result
    quiet = (GateOutcome.PASSED, GateOutcome.OFF)
    return GateView(shown.refused is None, tuple(one for one in shown.answers if one.outcome not in quiet))
