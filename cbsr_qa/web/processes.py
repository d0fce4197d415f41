"""Processes of runs, each with its own session and log, so that stopping the page never stops a run."""

import os
import shutil
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Final, Self

from cbsr_qa.app.command_hints import build_own_command
from cbsr_qa.config.paths import var_folder, writable_folder
from cbsr_qa.domain.errors import ConfigError, drop_command_lines
from cbsr_qa.web.guard import LOG

_LOG_NAME: Final = "%Y%m%dT%H%M%S%f"
#: Number of lines of a log that a page shows.
_SHOWN_LINES: Final = 6
#: Number of logs kept of each station.
_KEPT_LOGS: Final = 50


@dataclass(frozen=True, slots=True)
class Started:
    """A run that a page started.

    Parameters
    ----------
    process : None if another process of the page started it, before a restart.
    what : serial number or run, for people.
    log : file with the output of ``cbsr-qa run``.
    cancelled_by : who ended the process before its run had begun; empty for nobody.
    """

    process: "subprocess.Popen[bytes] | None"
    what: str
    log: Path
    at: datetime
    cancelled_by: str = ""

    @property
    def ended(self) -> int | None:
        """Exit code once it has ended; None before, and for a process of an earlier server."""
        return None if self.process is None else self.process.poll()

    def cancel(self, by: str) -> Self:
        """Have the process end, at once before its run has begun, in order afterwards; return who asked for it."""
        if self.process is not None:
            self.process.terminate()
        return replace(self, cancelled_by=by)

    def describe_refusal(self) -> str:
        """Return why the process ended without a run; empty if it did not, as far as is known."""
        if self.process is not None and not self.ended:
            return ""
        try:
            lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError as error:
            return "" if self.process is None else str(error)
        start = next((n for n in reversed(range(len(lines))) if lines[n].startswith("cbsr-qa:")), None)
        if start is None and self.process is None:  # the run was not refused so far
            return ""
        log_lines = drop_command_lines("\n".join(lines[start:])).splitlines()
        shown_lines = log_lines[-_SHOWN_LINES:] if start is None else log_lines[:_SHOWN_LINES]
        return "\n".join(line.removeprefix("cbsr-qa: ") for line in shown_lines)


def last_start(station: str) -> Started | None:
    """Return the last run of a station that an earlier server started; None without one."""
    logs = sorted((var_folder() / "control" / "logs" / station).glob("*.log"))
    if not logs:
        return None
    try:
        started_at = datetime.strptime(logs[-1].stem, _LOG_NAME).replace(tzinfo=UTC)
    except ValueError:
        return None
    return Started(None, "", logs[-1], started_at)


def start_run(station: str, arguments: Sequence[str], what: str, pin: str = "") -> Started:
    """Start ``cbsr-qa run`` with these arguments; returns at once.

    Parameters
    ----------
    station : name of the station, which names the folder of the log.
    pin : PIN of the operator, for the process alone; empty without one.

    Raises
    ------
    ConfigError
        If the log cannot be written, or the process cannot be started.
    """
    folder = writable_folder(var_folder() / "control" / "logs" / station)
    started_at = datetime.now(UTC)
    log = folder / f"{started_at:{_LOG_NAME}}.log"
    program = build_own_command("run", *arguments)
    unit = f"cbsr-qa-run-{station}-{log.stem}".replace(".", "_").replace(" ", "_")
    try:
        for old_log in sorted(folder.glob("*.log"))[: -_KEPT_LOGS or None]:
            old_log.unlink(missing_ok=True)
        scope = _scope()
        own_unit = [*scope, f"--unit={unit}"] if scope else []
        with log.open("xb") as output:
            process = subprocess.Popen(  # arguments are checked values, and no shell reads them
                [*own_unit, *program],
                stdin=subprocess.PIPE if pin else subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        if process.stdin is not None:
            with suppress(BrokenPipeError), process.stdin:  # it may have ended
                process.stdin.write(f"{pin}\n".encode())
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ConfigError(f"the run of {what} cannot be started: {error}", remedy=f"see also {folder}") from error
    LOG.info("%s: started the run of %s as process %d; log: %s", station, what, process.pid, log)
    return Started(process, what, log, started_at)


@cache
def _scope() -> tuple[str, ...]:
    """Return the command that starts a program as its own unit of systemd; empty if this process is in none."""
    program = shutil.which("systemd-run")
    if "INVOCATION_ID" not in os.environ or program is None:
        return ()
    manager = () if os.geteuid() == 0 else ("--user",)
    scope = (program, *manager, "--scope", "--quiet", "--collect")
    trial = subprocess.run([*scope, "true"], capture_output=True, check=False, timeout=10)
    if trial.returncode:
        LOG.warning("systemd-run makes no units for runs (%s); KillMode=process keeps runs alive", trial.stderr)
        return ()
    return scope
