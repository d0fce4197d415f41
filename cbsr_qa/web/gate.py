"""Answers of the gate on a sensor before its run, as the page shows them."""

from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace

from cbsr_qa.app.gate.people import asks_pin, is_pin_of
from cbsr_qa.app.run.preview import preview_gate
from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.config.loader import load_station
from cbsr_qa.config.merging import restore
from cbsr_qa.config.paths import database_url
from cbsr_qa.config.serials import fits_pattern
from cbsr_qa.domain.errors import CbsrError, RefusedError
from cbsr_qa.domain.plan.gate import GateCheck
from cbsr_qa.domain.plan.limits import Outcome, choose_disposition
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.run.gate import GateAnswer, GateOutcome
from cbsr_qa.store.opening import open_existing
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.runs.live import RunLook
from cbsr_qa.web.start import StartForm
from cbsr_qa.web.stations import ServedStation
from cbsr_qa.web.texts import text


@dataclass(frozen=True, slots=True)
class GateView:
    """Answers that say more than that all is well, and whether the run may begin.

    Parameters
    ----------
    may : whether the run may begin.
    asks_pin : whether it begins only with the PIN of the operator.
    answers : answers of the gate that are shown.
    earlier : its failure with another recipe that stands, or its latest run with the recipe, or with any; None before
        its first.
    is_first : whether it has no run with the recipe yet.
    runs : number of all runs of the sensor.
    recipe : name of the recipe.
    todo : what is done with the sensor by its earlier run; empty if that did not fail, or its recipe does not say.
    """

    may: bool
    asks_pin: bool
    answers: tuple[GateAnswer, ...]
    earlier: RunLook | None = None
    is_first: bool = True
    runs: int = 0
    recipe: str = ""
    todo: str = ""

    @property
    def asks_again(self) -> str:
        """The earlier run, if its result needs a person's consent to another test; else empty.

        Such are all results of the recipe, and a failure with another one.
        """
        earlier = self.earlier
        if earlier is None or (earlier.verdict is None and not earlier.altered):
            return ""
        return earlier.run if earlier.recipe == self.recipe or earlier.verdict is Outcome.FAIL else ""

    @property
    def pin_is_right(self) -> bool:
        """Whether the PIN that counted was right, or none was needed."""
        return not self.asks_pin or all(answer.check is not GateCheck.OPERATOR for answer in self.answers)

    @property
    def only_pin_is_wrong(self) -> bool:
        """Whether the run could begin with another PIN."""
        refused_checks = [answer.check for answer in self.answers if answer.outcome is GateOutcome.REFUSED]
        return self.asks_pin and refused_checks == [GateCheck.OPERATOR]


def gate_view(served: ServedStation, wanted: StartForm, database: str | None, *, with_pin: bool = False) -> GateView:
    """Ask the gate; the run's process asks again.

    Parameters
    ----------
    with_pin : whether the PIN counts; otherwise it has not been asked for yet.

    Raises
    ------
    RefusedError
        If a file, a folder or the database is wrong.
    """
    request = RunRequest(
        station=served.source,
        recipe=wanted.recipe.source,
        serial=wanted.serial,
        batch=wanted.batch,
        parts=wanted.parts,
        operator=wanted.operator,
        database=database,
        override=wanted.override,
    )
    result = preview_gate(request, (lambda _: wanted.pin) if with_pin else None).result
    quiet_outcomes = (GateOutcome.PASSED, GateOutcome.OFF)
    answers = tuple(answer for answer in result.answers if answer.outcome not in quiet_outcomes)
    view = GateView(result.refused is None, result.asks_pin, answers, recipe=wanted.recipe.name)
    return _add_earlier(view, database, wanted.serial)


def _add_earlier(view: GateView, database: str | None, serial: str) -> GateView:
    """Return the view with what the sensor did before, and what its earlier run says to do with it."""
    with open_existing(database_url(database)) or nullcontext() as store:
        if store is None:
            return view
        own = store.live.find_latest_of_sensor(serial, view.recipe)
        earlier = own
        if own is None or own.verdict is not Outcome.FAIL:
            earlier = store.live.find_standing_failure(serial, view.recipe) or own
        earlier = earlier or store.live.find_latest_of_sensor(serial)
        runs = store.lists.count_runs(RunSelection(serials=(serial,)))
        todo = read_disposition(store, earlier) if earlier is not None and earlier.verdict is Outcome.FAIL else ""
        return replace(view, earlier=earlier, is_first=own is None, runs=runs, todo=todo)


def read_disposition(store: Repository, failed: RunLook) -> str:
    """Return what is done with the sensor of a failed run; empty if its recipe does not say."""
    (listed,) = store.lists.read_named([failed.run])
    return choose_disposition(listed.failure_codes)


def read_latest(database: str | None, serial: str) -> RunLook | None:
    """Return the latest run of a sensor with any recipe; None before its first. RefusedError if it cannot be read."""
    with open_existing(database_url(database)) or nullcontext() as store:
        return None if store is None else store.live.find_latest_of_sensor(serial)


def is_serial(database: str | None, name: str, run: str) -> bool:
    """Whether a name is a serial number: a stored one, or one that fits the pattern of a run's sensor type.

    A name without digits does not fit, whatever the pattern allows: it is that of a person.
    """
    with open_existing(database_url(database)) or nullcontext() as store:
        if store is None or store.live.find_latest_of_sensor(name) is not None:
            return store is not None
        with suppress(CbsrError):  # a run that cannot be read must not keep anybody from a confirmation
            pattern = restore(store.runs.read_configuration(run)).serial_pattern
            return bool(pattern) and any(map(str.isdigit, name)) and fits_pattern(pattern, name)
    return False


def has_pin(served: ServedStation, operator: str) -> bool:
    """Whether the gate asks an operator for a PIN, by the current station file; RefusedError if the file is wrong."""
    return asks_pin(load_station(served.source).value.gate, operator)


def check_pin(served: ServedStation, operator: str, pin: str) -> None:
    """Check the PIN of an operator who resumes a run, by the current station file; the run's process checks again.

    RefusedError if the gate asks for a PIN, and this one is wrong.
    """
    gate = load_station(served.source).value.gate
    if asks_pin(gate, operator) and not is_pin_of(gate, operator, pin):
        raise RefusedError(text("gate.wrong_pin", operator=operator))
