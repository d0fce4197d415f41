"""One process per station: a lock file, who holds it, and where the holder listens."""

import hashlib
import json
import os
import re
import shlex
import signal
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, Self

from cbsr_qa.config.paths import var_folder
from cbsr_qa.domain.errors import AT_COMMAND_LINE, RefusedError
from cbsr_qa.system.files import FileLock, HeldError, holder
from cbsr_qa.system.json_text import parse_json

#: Names that are used as they are; others are shortened and get a digest.
_PLAIN: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,47}")
#: Longest path of a socket [bytes]: Linux takes 107, macOS 103.
_LONGEST: Final = 100
#: How long another process may hold the lock just to read it [s].
_LOOKED_AT_S: Final = 0.5


@dataclass(frozen=True, slots=True)
class Holder:
    """The process that uses a station.

    Parameters
    ----------
    started : start of the process in clock ticks since boot, which tells it from a later one with the same number;
        empty if unknown.
    who : operator, in words.
    doing : what the process does, e.g. ``"testing S-1 with nine locations"``.
    """

    station: str
    pid: int
    started: str
    who: str
    doing: str

    @classmethod
    def from_text(cls, text: bytes) -> Self | None:
        """Return the holder a lock file names, or None if it is not readable as such."""
        try:
            stated = parse_json(text)
        except ValueError:
            return None
        kinds = {"station": str, "pid": int, "started": str, "who": str, "doing": str}
        if not isinstance(stated, dict) or {key: type(value) for key, value in stated.items()} != kinds:
            return None
        return cls(**stated) if stated["pid"] > 0 else None

    @property
    def words(self) -> str:
        return f"{self.who or 'operator not stated'}, process {self.pid}, {self.doing}"

    def is_running(self) -> bool:
        """Whether the process still runs and is the one that took the lock."""
        if self.started:
            return _start_of(self.pid) == self.started
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        except OSError:
            pass
        return True

    def send(self, number: signal.Signals) -> bool:
        """Send a signal to the process if it is shown to hold the lock; returns whether it was sent."""
        if not self.started or not hasattr(os, "pidfd_open"):
            return False
        try:
            process = os.pidfd_open(self.pid)
        except OSError:
            return False
        try:
            # The descriptor stays with one process; these say that it is the right one.
            if not self.is_running() or station_holder(self.station) != self:
                return False
            signal.pidfd_send_signal(process, number)
        except OSError:
            return False
        finally:
            os.close(process)
        return True


def control_folder() -> Path:
    """Folder of lock files and sockets, below :func:`~cbsr_qa.config.paths.var_folder`."""
    return var_folder() / "control"


def control_socket(station: str) -> Path:
    """Return where the run at a station listens, a Unix socket; no longer than a socket's path may be."""
    path = (control_folder() / f"{_file_name(station)}.sock").absolute()
    if len(os.fsencode(path)) <= _LONGEST:
        return path
    digest = hashlib.sha256(os.fsencode(path)).hexdigest()[:24]
    return Path(f"/tmp/cbsr-qa-{os.getuid()}") / f"{digest}.sock"


def private_folder(folder: Path) -> None:
    """Create the folder of a socket; OSError if one outside of ours is another user's, or open to others."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if folder == control_folder().absolute():
        return
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise PermissionError(f"{folder} is not a folder of this user alone")


def station_holder(station: str) -> Holder | None:
    """Return the process that uses a station; None if it is free. The file of a killed process is removed."""
    text = holder(_lock_file(station))
    return None if text is None else Holder.from_text(text) or Holder(station, 0, "", "", "unknown")


@contextmanager
def station_held(station: str, *, who: str, doing: str) -> Iterator[Holder]:
    """Use a station alone while entered; the right ends with the process, even if it is killed.

    Folders that were made for the lock are removed again if nothing else is in them.

    Raises
    ------
    RefusedError
        If another process uses it, whom the message names, or the lock file cannot be written.
    """
    me = Holder(station, os.getpid(), _start_of(os.getpid()), who, doing)
    file = _lock_file(station)
    made = [folder for folder in (file.parent, *file.parent.parents) if not folder.exists()]
    lock = _acquire(file, me)
    try:
        yield me
    finally:
        lock.release()
        for folder in made:
            with suppress(OSError):  # it holds more than the lock
                folder.rmdir()


def refuse_busy(station: str) -> None:
    """Raise RefusedError, naming the holder, if a station is in use; nothing is written."""
    found = station_holder(station)
    if found is not None:
        raise _busy(station, found)


def _acquire(file: Path, me: Holder) -> FileLock:
    until_s = time.monotonic() + _LOOKED_AT_S
    while True:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            return FileLock(file, json.dumps(asdict(me)).encode(), shared=True)
        except HeldError as error:
            found = Holder.from_text(error.who)
            if time.monotonic() > until_s or (found is not None and found.is_running()):
                raise _busy(me.station, found) from error
        except FileNotFoundError as error:  # another process has removed the folder at its end
            if time.monotonic() > until_s:
                raise _unwritable(me.station, file, error) from error
        except OSError as error:
            raise _unwritable(me.station, file, error) from error
        time.sleep(0.01)


def _busy(station: str, found: Holder | None) -> RefusedError:
    who = "another process" if found is None or not found.pid else found.words
    return RefusedError(
        f"station {station!r} is in use: {who}",
        remedy=f"wait until it has ended, or stop it\n{AT_COMMAND_LINE}cbsr-qa station stop {shlex.quote(station)}",
    )


def _unwritable(station: str, file: Path, error: OSError) -> RefusedError:
    return RefusedError(
        f"station {station!r}: the lock file {file} cannot be written: {error.strerror or error}",
        remedy="make its folder writable, or name another one in CBSR_QA_VAR",
    )


def _lock_file(station: str) -> Path:
    return control_folder() / f"{_file_name(station)}.lock"


def _file_name(station: str) -> str:
    if _PLAIN.fullmatch(station):
        return station
    readable = re.sub(r"[^A-Za-z0-9-]+", "-", station).strip("-")[:32]
    return f"{readable or 'station'}.{hashlib.sha256(station.encode(errors='surrogatepass')).hexdigest()[:12]}"


def _start_of(pid: int) -> str:
    """Return the start of a process in clock ticks since boot (Linux); empty if it is unknown or has ended."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    state, *fields = text.rpartition(")")[2].split()
    return "" if state in "ZX" else fields[18]
