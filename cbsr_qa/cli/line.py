"""``cbsr-qa line``: one sensor after the other from a scanner, each in a run of its own."""

import json
import signal
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from datetime import datetime
from queue import SimpleQueue
from typing import Annotated, Any, Final

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import Database
from cbsr_qa.cli.output import note, say
from cbsr_qa.domain import ConfigError

#: What to do with a sensor, by the outcome of its run.
_DO: Final = {
    "pass": "put it with the passed sensors",
    "marginal": "it passed, only just: put it with the passed sensors, marked",
    "fail": "put it with the failed sensors",
}
_OTHERWISE: Final = "set it aside: it is neither passed nor failed"
_ENDS: Final = ("quit", "exit")


@command("line")
def line(
    station: Annotated[str, typer.Option(help="Station file, or the name of a shipped one.")],
    recipe: Annotated[str, typer.Option(help="Recipe file, or the name of a shipped one.")],
    operator: Annotated[str, typer.Option(help="Name of the operator.")] = "",
    batch: Annotated[str, typer.Option(help="Material batch of the sensors.")] = "",
    database: Database = None,
) -> int:
    """Test one sensor after the other: scan or type a serial number, wait for its verdict, scan the next.

    Ctrl-C during a run stops that run in order; at the prompt it ends, as quit and the end of input do. A scan during
    a run is ignored, with a message. Recipes that ask the operator are refused: use cbsr-qa run.

    Exit code 0 whatever the verdicts, 2 if a name is not allowed.
    """
    from cbsr_qa.config import validate_batch, validate_operator

    validate_batch(batch)
    validate_operator(operator)
    given = {"--station": station, "--recipe": recipe, "--operator": operator, "--batch": batch}
    given["--database"] = database or ""
    options = [word for name, value in given.items() if value for word in (name, value)]
    tested = _Line(options)
    tested.work()
    tested.count(database)
    return 0


@dataclass(slots=True)
class _Line:
    """A loop over scans; ``options`` are those of every run."""

    options: list[str]
    _heard: "SimpleQueue[tuple[str, str]]" = field(default_factory=SimpleQueue)
    _serials: list[str] = field(default_factory=list)
    _began: datetime = field(default_factory=lambda: datetime.now().astimezone())

    def work(self) -> None:
        """Test sensors until the input ends."""
        threading.Thread(target=self._listen, name="scanner", daemon=True).start()
        try:
            while True:
                note("\nScan the next sensor (quit ends):")
                kind, text = self._heard.get()
                if kind == "end" or text.lower() in _ENDS:
                    return
                if text and self._allowed(text) and not self._test(text):
                    return
        except KeyboardInterrupt:
            return

    def count(self, database: str | None) -> None:
        """Print how many of these sensors passed."""
        from cbsr_qa.config import database_url
        from cbsr_qa.domain.results import RunSelection
        from cbsr_qa.store import open_store
        from cbsr_qa.studies.shift import counts_words, shift_summary, yield_words

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

    def _allowed(self, serial: str) -> bool:
        from cbsr_qa.config import validate_serial

        try:
            validate_serial(serial)
        except ConfigError as error:
            note(f"not a serial number: {error.reason}")
            return False
        return True

    def _test(self, serial: str) -> bool:
        """Run one sensor and show its verdict; False if the input has ended meanwhile."""
        from cbsr_qa.app import own_command

        process = subprocess.Popen(
            own_command("run", *self.options, "--serial", serial, "--json"),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,  # a log of lines: a bar would be torn by what is typed
            start_new_session=True,  # the terminal's Ctrl-C reaches the run once, from here
            text=True,
        )
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
        ignored, more = self._wait(process, serial)
        document = "".join(printed)
        _show(serial, document)
        if '"run"' in document:
            self._serials.append(serial)
        for scan in ignored:
            note(f"{scan!r} was scanned during the run and is ignored: scan it again")
        return more

    def _wait(self, process: "subprocess.Popen[str]", serial: str) -> tuple[list[str], bool]:
        """Wait for the end of a run; return what was scanned meanwhile, and whether there is more input."""
        ignored, more = list[str](), True
        while True:
            try:
                kind, text = self._heard.get()
                if kind == "ended":
                    return ignored, more
                more = more and kind != "end"
                if text.lower() in _ENDS:
                    more = False
                    note(f"ending after the run of {serial}")
                elif text:
                    ignored.append(text)
                    note(f"{text!r} is ignored: the run of {serial} is under way")
            except KeyboardInterrupt:
                note(f"stopping the run of {serial} …")
                process.send_signal(signal.SIGINT)


def _show(serial: str, printed: str) -> None:
    """Show a verdict between rules, with its reason and what to do with the sensor."""
    try:
        found: dict[str, Any] = json.loads(printed)
    except ValueError:
        found = {}
    finished = found.get("end") == "finished"
    outcome = str(found.get("outcome", "")) if finished else ""
    word = outcome.upper() or "NO VERDICT"
    rule = "=" * 72
    reason = str(found.get("reason") or "the message above says why")
    note(f"\n{rule}\n  {serial}:  {word}\n  {reason}\n  {_DO.get(outcome, _OTHERWISE)}\n{rule}")
