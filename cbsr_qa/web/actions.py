"""Actions of an operator: check a sensor, start, resume, pause, continue, stop, answer.

Every text of a form is checked by the rules of the command line before anything is done with it.
"""

import asyncio
import unicodedata
from collections.abc import Awaitable, Callable
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, Response

from cbsr_qa.config.serials import validate_operator, validate_reason
from cbsr_qa.domain.errors import CbsrError, RefusedError
from cbsr_qa.web.gate import check_pin, gate_view, has_pin
from cbsr_qa.web.guard import LOG
from cbsr_qa.web.guesses import Guesses, TooManyGuessesError
from cbsr_qa.web.line import Line
from cbsr_qa.web.pages import Pages
from cbsr_qa.web.processes import start_run
from cbsr_qa.web.start import StartForm, resume_arguments
from cbsr_qa.web.state import Mode
from cbsr_qa.web.texts import refusal_words, text

Action = Callable[[str, dict[str, str]], Awaitable[Response]]

#: Key of the text shown when a run does as it was asked, by request.
_DONE = {
    "pause": "control.pausing",
    "continue": "control.continuing",
    "stop": "control.stopping",
    "emergency": "control.emergency_done",
}


class Actions:
    """Answers to forms, in JSON: ``parts`` of the page to replace, and ``words`` to say."""

    def __init__(self, line: Line, pages: Pages) -> None:
        self._line, self._pages = line, pages
        self._beginning = {station: asyncio.Lock() for station in line.stations}
        self._pins = Guesses()

    def list_actions(self) -> dict[str, Action]:
        """Return the actions of a station by the last part of their address."""
        channel_actions = {do: self._make_request(do) for do in _DONE}
        form_actions = {"check": self.check, "start": self.start, "resume": self.resume, "answer": self.answer}
        return {name: self._word_refusals(action) for name, action in (channel_actions | form_actions).items()}

    async def check(self, station: str, form: dict[str, str]) -> Response:
        """Say whether a sensor may be tested, and offer to start."""
        watch = self._line.stations[station]
        if not form.get("serial"):
            raise RefusedError(text("station.no_sensor_asked"))
        start_form = StartForm.from_form(watch.served, form)
        view = await run_in_threadpool(gate_view, watch.served, start_form, self._line.database)
        gate = ["gate", self._pages.gate(station, start_form, view)]
        # An interrupted run stays on the page, with its warning, until it is resumed or another run begins.
        is_interrupted = watch.snapshot is not None and watch.snapshot.mode is Mode.INTERRUPTED
        return _json_answer(parts=[gate] if is_interrupted else [gate, ["verdict", ""]])

    async def start(self, station: str, form: dict[str, str]) -> Response:
        """Start a run, or show why the gate refuses it."""
        watch = self._line.stations[station]
        start_form = StartForm.from_form(watch.served, form)
        guesser = await self.count_pin(station, start_form.operator, start_form.pin)
        view = await run_in_threadpool(gate_view, watch.served, start_form, self._line.database, with_pin=True)
        if view.pin_is_right:
            self._pins.accept(guesser)
        if not view.may:
            return _json_answer(parts=[["gate", self._pages.gate(station, start_form, view)]])
        arguments = start_form.arguments(watch.served, self._line.database)
        await self._begin(station, arguments, start_form.serial, start_form.pin)
        return _json_answer(words=text("station.started", serial=start_form.serial))

    async def resume(self, station: str, form: dict[str, str]) -> Response:
        """Resume the latest run of the station."""
        watch = self._line.stations[station]
        look = watch.look
        if look is None or look.run != form.get("run"):
            raise RefusedError(text("problem.no_run"))
        operator = validate_operator(form.get("operator", look.operator))
        pin = form.get("pin", "")
        guesser = await self.count_pin(station, operator, pin)
        await run_in_threadpool(check_pin, watch.served, operator, pin)
        self._pins.accept(guesser)
        arguments = resume_arguments(watch.served, look.run, operator, self._line.database)
        await self._begin(station, arguments, look.serial, pin)
        return _json_answer(words=text("station.resumed"))

    async def count_pin(self, station: str, operator: str, pin: str) -> tuple[str, str]:
        """Count a PIN as a guess; return whose it is (station, operator). TooManyGuessesError if it has to wait.

        Only guesses at operators who have a PIN count: made-up names would push those out of memory.
        """
        guesser = (station, unicodedata.normalize("NFC", operator))
        if pin:
            has_own_pin = await run_in_threadpool(has_pin, self._line.stations[station].served, operator)
            if has_own_pin:
                self._pins.admit(guesser, pin)
        return guesser

    async def _begin(self, station: str, arguments: list[str], serial: str, pin: str) -> None:
        watch = self._line.stations[station]
        async with self._beginning[station]:  # if two people start at once, the second is refused
            if watch.busy:
                raise RefusedError(text("station.busy"))
            watch.started = await run_in_threadpool(start_run, station, arguments, serial, pin)
        self._line.wake(station)

    async def answer(self, station: str, form: dict[str, str]) -> Response:
        """Answer a prompt; the first answer counts."""
        channel = self._line.stations[station].channel
        number = form.get("prompt", "")
        if not (number.isascii() and number.isdigit() and len(number) < 10):
            raise RefusedError(text("prompt.other"))
        answer = validate_reason(form.get("text", ""))
        refusal = await channel.ask("answer", by=text("control.at_the_page"), prompt=int(number), text=answer)
        return _json_answer(words=refusal or text("control.answered"))

    def _make_request(self, do: str) -> Action:
        async def tell(station: str, form: dict[str, str]) -> Response:
            refusal = await self._line.stations[station].channel.ask(do, by=text("control.at_the_page"))
            LOG.info("%s: %s asked for%s", station, do, f", refused: {refusal}" if refusal else "")
            return _json_answer(words=refusal or text(_DONE[do]))

        return tell

    def _word_refusals(self, action: Action) -> Action:
        async def answer_in_words(station: str, form: dict[str, str]) -> Response:
            try:
                return await action(station, form)
            except TooManyGuessesError as wait:
                LOG.warning("%s: too many wrong PINs", station)
                return _json_answer(
                    words=text("refused.pins", operator=form.get("operator", ""), seconds=wait.wait_s)
                )
            except CbsrError as error:
                LOG.warning("%s: %s", station, error.reason)
                words = refusal_words(error)
                return _json_answer(words=words, parts=[["gate", ""]])

        return answer_in_words


def _json_answer(**what: Any) -> Response:
    return JSONResponse(what)
