"""Actions of an operator: check a sensor, start, cancel, resume, confirm the bench, pause, continue, stop, answer.

Every text of a form is checked by the rules of the command line before anything is done with it.
"""

import asyncio
import unicodedata
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, Response

from cbsr_qa.app.run.control import confirm_bench
from cbsr_qa.config.serials import LONGEST, validate_operator, validate_reason, validate_serial
from cbsr_qa.domain.errors import CbsrError, RefusedError
from cbsr_qa.web.confirmations import needs_confirmation
from cbsr_qa.web.gate import GateView, check_pin, gate_view, has_pin, is_serial, read_latest
from cbsr_qa.web.guard import LOG
from cbsr_qa.web.guesses import Guesses, TooManyGuessesError
from cbsr_qa.web.line import Line
from cbsr_qa.web.pages import Pages
from cbsr_qa.web.processes import start_run
from cbsr_qa.web.start import StartForm, find_wrong_field, resume_arguments, split_parts
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
    """Answers to forms, in JSON.

    ``parts`` of the page to replace, ``fields`` to fill in, and ``words`` to say; ``passes``: they go once the
    station shows another state; ``refused``: nothing was done; ``wrong``: why a field cannot be used, by its name.
    """

    def __init__(self, line: Line, pages: Pages) -> None:
        self._line, self._pages = line, pages
        self._beginning = {station: asyncio.Lock() for station in line.stations}
        self._pins = Guesses()

    def list_actions(self) -> dict[str, Action]:
        """Return the actions of a station by the last part of their address."""
        channel_actions = {do: self._make_request(do) for do in _DONE}
        form_actions = {
            "check": self.check,
            "leave": self.leave,
            "start": self.start,
            "cancel": self.cancel,
            "resume": self.resume,
            "confirm": self.confirm,
            "answer": self.answer,
        }
        return {name: self._word_refusals(action) for name, action in (channel_actions | form_actions).items()}

    async def check(self, station: str, form: dict[str, str]) -> Response:
        """Say whether a sensor may be tested, and offer to start.

        A badge or a part that is scanned belongs to ``checked``, the sensor that the page shows, if there is one.
        """
        watch = self._line.stations[station]
        scanned, checked = form.get("serial", ""), form.get("checked", "")
        if not scanned:
            raise RefusedError(text("station.no_sensor_asked"))
        fields, words = {}, ""
        if any(scanned == operator.name for operator in watch.served.station.gate.operators):
            fields, words = {"operator": scanned}, text("gate.badge", operator=scanned)
        elif "=" in scanned:  # a part; one that is given twice is refused, and what was scanned before stays
            stated = split_parts(f"{form.get('parts', '')}, {scanned}")
            fields = {"parts": ", ".join(map(str, stated))}
            words = text("gate.part_of" if checked else "gate.part", part=scanned, serial=checked)
        elif scanned != checked:
            fields = await run_in_threadpool(self._recall_sensor, form)
        if words and not checked:
            return _json_answer(fields={**fields, "serial": ""}, words=words)
        fields["serial"] = checked if words else scanned
        start_form = StartForm.from_form(watch.served, {**form, **fields})
        self._refuse_elsewhere(station, start_form.serial)
        view = await run_in_threadpool(gate_view, watch.served, start_form, self._line.database)
        parts = [["gate", self._pages.gate(station, start_form, view)], ["refused", ""]]
        parts += self._scan_parts(station, start_form.serial, view)
        return _json_answer(parts=parts, fields=fields, words=words)

    def _scan_parts(self, station: str, serial: str, view: GateView | None) -> list[list[str]]:
        """Return the parts that show a scanned sensor in place of the latest run.

        A run that was cut off stays on the page, with its warning, until it is resumed or another run begins.
        """
        snapshot = self._line.stations[station].snapshot
        if snapshot is not None and (snapshot.mode.runs or snapshot.mode in (Mode.INTERRUPTED, Mode.UNSAFE)):
            return []
        state = ["state", self._pages.render_scan(station, serial, view)]
        return [state] if snapshot is not None and snapshot.resumable else [state, ["verdict", ""]]

    def _refuse_sensor(self, station: str, form: dict[str, str], error: CbsrError) -> Response:
        """Say why a sensor cannot be tested: at the field that is wrong, if one is.

        A part that cannot be used changes nothing for the sensor that is shown.
        """
        scanned, words = form["serial"][:LONGEST], refusal_words(error)
        if not scanned or "=" in scanned:
            return _json_answer(words=words, fields={"serial": form.get("checked", "")}, refused=True)
        wrong = find_wrong_field(form)
        gate = self._pages.render_wrong_field(station, scanned, wrong) if wrong else ""
        parts = [["gate", gate], ["refused", ""], *self._scan_parts(station, scanned, None)]
        if wrong:
            return _json_answer(parts=parts, wrong={wrong: words})
        return _json_answer(parts=parts, words=words, refused=True)

    def _recall_sensor(self, form: dict[str, str]) -> dict[str, str]:
        """Return the fields of parts and batch of a sensor that is scanned anew: as stated, else as in its last run.

        Parts on the page are those of the sensor that it showed, if it showed one. So is a batch that was filled in:
        ``recalled``.
        """
        stated = "" if form.get("checked") else form.get("parts", "")
        latest = read_latest(self._line.database, validate_serial(form["serial"]))
        batch = form.get("batch", "")
        if batch == form.get("recalled"):
            batch = ""
        recalled = "" if batch or latest is None else latest.batch
        parts = stated or ("" if latest is None else ", ".join(map(str, latest.parts)))
        return {"parts": parts, "batch": batch or recalled, "recalled": recalled}

    def _refuse_elsewhere(self, station: str, serial: str) -> None:
        """Refuse a sensor that another station of the line is testing."""
        for other, watch in self._line.stations.items():
            snapshot = watch.snapshot
            if other != station and snapshot is not None and snapshot.mode.runs and snapshot.serial == serial:
                raise RefusedError(text("station.tested_elsewhere", serial=serial, station=other))

    async def leave(self, station: str, form: dict[str, str]) -> Response:
        """Show the station as before a scan: the sensor is not tested now."""
        parts = [["gate", ""], *self._pages.idle_parts(station)]
        return _json_answer(parts=parts, fields={"serial": "", "parts": ""})

    async def start(self, station: str, form: dict[str, str]) -> Response:
        """Start a run, or show why the gate refuses it."""
        watch = self._line.stations[station]
        start_form = StartForm.from_form(watch.served, form)
        self._refuse_elsewhere(station, start_form.serial)
        guesser = await self.count_pin(station, start_form.operator, start_form.pin)
        view = await run_in_threadpool(gate_view, watch.served, start_form, self._line.database, with_pin=True)
        if view.pin_is_right:
            self._pins.accept(guesser)
        if not view.may or view.asks_again != start_form.again:
            return _json_answer(parts=[["gate", self._pages.gate(station, start_form, view)]])
        arguments = start_form.arguments(watch.served, self._line.database)
        await self._begin(station, arguments, start_form.serial, start_form.pin)
        return _json_answer(words=text("station.started", serial=start_form.serial), passes=True)

    async def cancel(self, station: str, form: dict[str, str]) -> Response:
        """End the process of a run that is starting; a run that has begun meanwhile stops in order."""
        watch = self._line.stations[station]
        started, by = watch.started, self._asker(station, form)
        if started is None or started.process is None or started.ended is not None:
            raise RefusedError(text("control.no_run"))
        watch.started = started.cancel(by)
        LOG.info("%s: the start of %s was cancelled by %s", station, started.what, by)
        self._line.wake(station)
        return _json_answer(words=text("control.cancelled", serial=started.what), passes=True)

    async def resume(self, station: str, form: dict[str, str]) -> Response:
        """Resume the latest run of the station, as the operator who works there now."""
        watch = self._line.stations[station]
        look = watch.look
        if look is None or look.run != form.get("run"):
            raise RefusedError(text("problem.no_run"))
        operator = validate_operator(form.get("operator", form.get("by") or look.operator))
        pin = form.get("pin", "")
        guesser = await self.count_pin(station, operator, pin)
        await run_in_threadpool(check_pin, watch.served, operator, pin)
        self._pins.accept(guesser)
        arguments = resume_arguments(watch.served, look.run, operator, self._line.database)
        await self._begin(station, arguments, look.serial, pin)
        return _json_answer(words=text("station.resumed"), passes=True)

    async def confirm(self, station: str, form: dict[str, str]) -> Response:
        """Take an operator's word that the bench is safe after an emergency stop or a fault.

        A serial number that was scanned into the field of the name is nobody's word.
        """
        watch = self._line.stations[station]
        look = watch.look
        by = validate_operator(form.get("by", ""))
        if not by:
            raise RefusedError(text("confirm.no_name"))
        if look is None or look.run != form.get("run"):
            raise RefusedError(text("problem.no_run"))
        if all(by != operator.name for operator in watch.served.station.gate.operators) and await run_in_threadpool(
            is_serial, self._line.database, by, look.run
        ):
            raise RefusedError(text("confirm.serial", name=by))
        if needs_confirmation(look):
            await run_in_threadpool(confirm_bench, look.run, look.session_at, station, by)
            LOG.info("%s: %s confirmed that the bench is safe after run %s", station, by, look.run)
        self._line.wake(station)
        return _json_answer(words=text("confirm.done", by=by), passes=True)

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
            if watch.look is not None and needs_confirmation(watch.look):
                raise RefusedError(text("confirm.first"))
            watch.started = await run_in_threadpool(start_run, station, arguments, serial, pin)
        self._line.wake(station)

    async def answer(self, station: str, form: dict[str, str]) -> Response:
        """Answer a prompt; the first answer counts."""
        channel = self._line.stations[station].channel
        number = form.get("prompt", "")
        if not (number.isascii() and number.isdigit() and len(number) < 10):
            raise RefusedError(text("prompt.other"))
        answer = validate_reason(form.get("text", ""))
        refusal = await channel.ask("answer", by=self._asker(station, form), prompt=int(number), text=answer)
        return _json_answer(words=refusal or text("control.answered"), passes=not refusal)

    def _make_request(self, do: str) -> Action:
        async def tell(station: str, form: dict[str, str]) -> Response:
            by = self._asker(station, form)
            refusal = await self._line.stations[station].channel.ask(do, by=by)
            LOG.info("%s: %s asked for by %s%s", station, do, by, f", refused: {refusal}" if refusal else "")
            return _json_answer(words=refusal or text(_DONE[do]), passes=not refusal)

        return tell

    def _asker(self, station: str, form: dict[str, str]) -> str:
        """Return who asks: the operator of that browser, else somebody beside the operator of the run."""
        watch = self._line.stations[station]
        look, control = watch.look, watch.channel.control
        with suppress(CbsrError):  # a name that is not allowed must not keep anybody from an emergency stop
            if by := validate_operator(form.get("by", "")):
                return by
        named = look.operator if look is not None and control is not None and look.run == control.run else ""
        return text("control.somebody", operator=named) if named else text("control.at_the_page")

    def _word_refusals(self, action: Action) -> Action:
        async def answer_in_words(station: str, form: dict[str, str]) -> Response:
            try:
                return await action(station, form)
            except TooManyGuessesError as wait:
                LOG.warning("%s: too many wrong PINs", station)
                return _json_answer(
                    words=text("refused.pins", operator=form.get("operator", ""), seconds=wait.wait_s), refused=True
                )
            except CbsrError as error:
                LOG.warning("%s: %s", station, error.reason)
                if "serial" in form:
                    return self._refuse_sensor(station, form, error)
                parts = [["gate", ""], *self._pages.idle_parts(station)]
                return _json_answer(words=refusal_words(error), parts=parts, refused=True)

        return answer_in_words


def _json_answer(**what: Any) -> Response:
    return JSONResponse(what)
