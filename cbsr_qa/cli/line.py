"""``cbsr-qa line``: one sensor after the other from a scanner, each in a separate run."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime
from queue import SimpleQueue
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import Database, Parts
from cbsr_qa.cli.output import note, read_pin, say
from cbsr_qa.domain.errors import ConfigError, RefusedError

if TYPE_CHECKING:
    from cbsr_qa.domain.plan.plan import Station
    from cbsr_qa.station.control.client import RunChannel

#: Instruction for the sensor, by the outcome of its run.
_DO: Final = {
    "pass": "put it with the passed sensors",
    "marginal": "it passed, only just: put it with the passed sensors, marked",
    "fail": "put it with the failed sensors",
}
_OTHERWISE: Final = "set it aside: it is neither passed nor failed"
_ENDS: Final = ("quit", "exit")
#: Interval between attempts to reach the run's channel [s].
_AGAIN_S: Final = 0.2


@command("line")
def line(
    station: Annotated[str, typer.Option(help="Station file, or the name of a shipped one.")],
    recipe: Annotated[str, typer.Option(help="Recipe file, or the name of a shipped one.")],
    operator: Annotated[str, typer.Option(help="Name of the operator.")] = "",
    batch: Annotated[str, typer.Option(help="Material batch of the sensors.")] = "",
    part: Parts = None,
    database: Database = None,
) -> int:
    """Test one sensor after the other: scan or type a serial number, wait for its verdict, scan the next.

    Ctrl-C during a run stops that run cleanly; at the prompt it ends, as quit and the end of input do. SIGTERM stops
    a run in order, then ends. A question of the recipe is shown, and the next line typed answers it; any other scan
    during a run is ignored, with a message. A PIN that the station's gate knows is asked for once, before all.

    Exit code 0 whatever the verdicts, 2 if a name is not allowed, or the station file or the PIN is wrong.
    """
    from cbsr_qa.config.loader import load_station
    from cbsr_qa.config.serials import read_parts, validate_batch, validate_operator

    validate_batch(batch)
    validate_operator(operator)
    bench = load_station(station).value
    value_by_option = {"--station": station, "--recipe": recipe, "--operator": operator, "--batch": batch}
    value_by_option["--database"] = database or ""
    options = [word for name, value in value_by_option.items() if value for word in (name, value)]
    options += [f"--part={sensor_part}" for sensor_part in read_parts(part or ())]
    loop = _Line(bench.name, operator, [*options, "--prompts", "channel"], _pin_of(bench, operator))
    with loop.signals_heard():
        loop.work()
        loop.count(database)
    return 0


def _pin_of(station: "Station", operator: str) -> str:
    """Ask for the operator's PIN; empty if the gate asks for none. RefusedError if it is wrong."""
    from cbsr_qa.app.gate.people import asks_pin, is_pin_of

    if not asks_pin(station.gate, operator):
        return ""
    pin = read_pin(f"PIN of {operator}")
    if not is_pin_of(station.gate, operator, pin):
        raise RefusedError(f"the PIN given is not that of {operator}", remedy="start again, or name another operator")
    return pin


@dataclass(slots=True)
class _Line:
    """A loop over scans.

    Parameters
    ----------
    options : options of every run.
    pin : PIN given to every run; empty without one.
    """

    station: str
    operator: str
    options: list[str]
    pin: str = field(repr=False)
    _heard: "SimpleQueue[tuple[str, str]]" = field(default_factory=SimpleQueue)
    _serials: list[str] = field(default_factory=list)
    _began: datetime = field(default_factory=lambda: datetime.now().astimezone())

    def work(self) -> None:
        """Test sensors until the input ends."""
        threading.Thread(target=self._listen, name="scanner", daemon=True).start()
        has_input = True
        while has_input:
            note("\nScan the next sensor (quit ends):")
            kind, text = self._heard.get()
            if kind in ("end", "signal") or text.lower() in _ENDS:
                return
            if kind == "scan" and text and self._is_valid(text):
                has_input = self._test(text)

    @contextmanager
    def signals_heard(self) -> Iterator[None]:
        """Queue signals like scans while entered, so that earlier scans come first."""

        def hear(number: int, frame: FrameType | None) -> None:
            self._heard.put(("signal", signal.Signals(number).name))

        numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        previous_handlers = {n: signal.signal(n, hear) for n in numbers if signal.getsignal(n) is not signal.SIG_IGN}
        try:
            yield
        finally:
            for number, handler in previous_handlers.items():
                signal.signal(number, handler)

    def count(self, database: str | None) -> None:
        """Print how many of these sensors passed."""
        from cbsr_qa.app.shift.report import counts_words, yield_words
        from cbsr_qa.app.shift.summary import shift_summary
        from cbsr_qa.config.paths import database_url
        from cbsr_qa.domain.results.fleet import RunSelection
        from cbsr_qa.store.opening import open_store

        if not self._serials:
            say("no sensor was tested")
            return
        selection = RunSelection(serials=tuple(dict.fromkeys(self._serials)), from_moment=self._began, checks=False)
        with open_store(database_url(database)) as store:
            total = shift_summary(store, selection).total
        say(f"{counts_words(total)}; yield {yield_words(total.test_yield)}")

    def _listen(self) -> None:
        for text in sys.stdin or ():
            self._heard.put(("scan", text.strip()))
        self._heard.put(("end", ""))

    def _is_valid(self, serial: str) -> bool:
        from cbsr_qa.config.serials import validate_serial

        try:
            validate_serial(serial)
        except ConfigError as error:
            note(f"not a serial number: {error.reason}")
            return False
        return True

    def _test(self, serial: str) -> bool:
        """Run one sensor and show its verdict; False if the input has ended meanwhile."""
        from cbsr_qa.app.command_hints import build_own_command

        process = subprocess.Popen(
            build_own_command("run", *self.options, "--serial", serial, "--json"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,  # a log of lines: a bar would be torn by what is typed
            start_new_session=True,  # the terminal's Ctrl-C reaches the run once, from here
            text=True,
        )
        assert process.stdin is not None
        with suppress(BrokenPipeError), process.stdin:  # it may have ended
            process.stdin.write(f"{self.pin}\n" if self.pin else "")
        printed: list[str] = []

        def log() -> None:
            for text in process.stderr or ():
                note(text.rstrip("\n"))

        def read() -> None:
            logs = threading.Thread(target=log, name="messages", daemon=True)
            logs.start()
            printed.extend(process.stdout or ())
            logs.join()
            process.wait()
            self._heard.put(("ended", ""))

        threading.Thread(target=read, name="run", daemon=True).start()
        threading.Thread(target=self._follow, args=(process,), name="prompts", daemon=True).start()
        ignored_scans, has_input = self._wait(process, serial)
        document = "".join(printed)
        _show(serial, document)
        if '"run"' in document:
            self._serials.append(serial)
        for scan in ignored_scans:
            note(f"{scan!r} was scanned during the run and is ignored: scan it again")
        return has_input

    def _wait(self, process: "subprocess.Popen[str]", serial: str) -> tuple[list[str], bool]:
        """Wait for the end of a run; return what was scanned meanwhile, and whether there is more input."""
        ignored_scans, has_input, prompt = list[str](), True, ""
        while True:
            kind, text = self._heard.get()
            match kind:
                case "ended":
                    return ignored_scans, has_input
                case "end":
                    has_input = False
                case "signal":
                    has_input = has_input and text == "SIGINT"
                    note(f"stopping the run of {serial} …")
                    process.send_signal(signal.SIGINT)
                case "prompt":
                    prompt = text
                case _ if text.lower() in _ENDS:
                    has_input = False
                    note(f"ending after the run of {serial}")
                case _ if prompt:
                    self._answer(prompt, text)
                case _ if text:
                    ignored_scans.append(text)
                    note(f"{text!r} is ignored: the run of {serial} is under way")

    def _follow(self, process: "subprocess.Popen[str]") -> None:
        """Show the questions of a run as they come, and report the number of the open question, if any."""
        from cbsr_qa.station.control.client import RunChannel

        shown_number = ""
        while process.poll() is None:
            with suppress(RefusedError, OSError), RunChannel.connect(self.station) as channel:
                # The run leads its own session; another process may use the station.
                is_own_run = os.getsid(channel.hello["pid"]) == process.pid
                for prompt in _prompts(channel) if is_own_run else ():
                    number = "" if prompt is None else str(prompt["prompt"])
                    if number == shown_number:
                        continue
                    shown_number = number
                    self._heard.put(("prompt", number))
                    if prompt is not None:
                        picture = f"  picture: {prompt['picture']}\n" if prompt["picture"] else ""
                        note(f"\n  {prompt['text']}\n{picture}Type the answer, or just press Enter:")
            time.sleep(_AGAIN_S)  # it has no channel yet, or has closed it

    def _answer(self, prompt: str, text: str) -> None:
        from cbsr_qa.config.serials import validate_reason
        from cbsr_qa.station.control.client import RunChannel

        try:
            with RunChannel.connect(self.station) as channel:
                channel.ask(
                    "answer", by=self.operator or "the operator", prompt=int(prompt), text=validate_reason(text)
                )
        except (ConfigError, RefusedError) as error:
            note(f"{text!r} was not accepted: {error.reason}")


def _prompts(channel: "RunChannel") -> Iterator[dict[str, Any] | None]:
    """Yield the open question each time the run states it; None for none."""
    yield channel.hello["state"]["prompt"]
    while True:
        try:
            for line in channel.lines():
                if line["type"] == "state":
                    yield line["prompt"]
            return  # it was closed
        except TimeoutError:  # nothing happens while a question is open
            continue


def _show(serial: str, printed: str) -> None:
    """Show a verdict between rules, with its reason and what to do with the sensor."""
    try:
        result: dict[str, Any] = json.loads(printed)
    except ValueError:
        result = {}
    finished = result.get("end") == "finished"
    outcome = str(result.get("outcome", "")) if finished else ""
    word = outcome.upper() or "NO VERDICT"
    rule = "=" * 72
    reason = str(result.get("reason") or "the message above says why")
    note(f"\n{rule}\n  {serial}:  {word}\n  {reason}\n  {_DO.get(outcome, _OTHERWISE)}\n{rule}")
