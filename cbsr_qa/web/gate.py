"""What the gate says of a sensor before its run, as the page shows it."""

from dataclasses import dataclass

from cbsr_qa.app.gate import GateRequest, ask_before
from cbsr_qa.config import calibrations_folder, database_url, reports_folder
from cbsr_qa.domain.run import GateAnswer, GateOutcome
from cbsr_qa.plugin import discover
from cbsr_qa.station import configure
from cbsr_qa.web.start import StartForm
from cbsr_qa.web.stations import ServedStation


@dataclass(frozen=True, slots=True)
class GateView:
    """Answers that say more than that all is well, and whether the run may begin."""

    may: bool
    answers: tuple[GateAnswer, ...]


def gate_view(served: ServedStation, wanted: StartForm, database: str | None) -> GateView:
    """Ask the gate; the run's process asks again. RefusedError if a file is wrong."""
    plugins = discover()
    configuration = configure(
        served.source, wanted.recipe.source, sensor_type=None, material=None, seed=0, plugins=plugins
    )
    request = GateRequest(
        serial=wanted.serial,
        batch=wanted.batch,
        operator=wanted.operator,
        database=database_url(database),
        folders=(reports_folder(), calibrations_folder()),
        override=wanted.override,
        preview=True,
    )
    answers = ask_before(request, configuration, plugins)
    quiet = (GateOutcome.PASSED, GateOutcome.OFF)
    may = all(one.outcome is not GateOutcome.REFUSED for one in answers)
    return GateView(may, tuple(one for one in answers if one.outcome not in quiet))
