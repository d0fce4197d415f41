"""One program at a time talks to an instrument: a lock per port or resource, which says who holds it."""

import fcntl
import hashlib
import json
import os
import shlex
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from cbsr_qa.clock import RealClock
from cbsr_qa.domain.errors import InstrumentError

#: Below the computer's directory for temporary files, so that programs of all its users meet there.
_FOLDER: Final = "cbsr-qa-locks"
_LONGEST_COMMAND: Final = 160


class AddressLock:
    """Holds an address until it is released or the process ends, however it ends.

    The lock is the kernel's (``flock``) on a file that is never removed: what is left of a program that was killed
    keeps nobody out. A second instrument of the same program is refused like another program's.

    Parameters
    ----------
    role : of the instrument, for messages.
    address : as the station file states it; paths of one device are one address, also through links to it.
    device : what is locked, where one device has addresses that are written in several ways.

    Raises
    ------
    InstrumentError
        If it is held, naming by whom; or if the file for it cannot be made.
    """

    def __init__(self, role: str, address: str, *, device: str = "") -> None:
        self._file: int | None = None
        path = lock_path(device or address)
        try:
            file = _opened(path)
        except OSError as error:
            reason = f"it cannot be locked against a second program: {error}"
            raise InstrumentError(role, address, reason, remedy=f"let this user write in {path.parent}") from error
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            by = _holder(os.pread(file, 4096, 0))
            os.close(file)
            raise InstrumentError(
                role, address, f"it is in use by {by}", remedy="end that program, or wait for it"
            ) from error
        self._file = file
        os.ftruncate(file, 0)
        os.pwrite(file, json.dumps(_self(role)).encode(), 0)

    def release(self) -> None:
        """Let others have it; may be called more than once."""
        file, self._file = self._file, None
        if file is not None:
            # Said explicitly: a copy of the file in a forked worker would hold the lock on.
            with suppress(OSError):
                os.ftruncate(file, 0)
                fcntl.flock(file, fcntl.LOCK_UN)
            os.close(file)


def lock_path(address: str) -> Path:
    """File that is locked for an address."""
    one = str(Path(address).resolve()) if address.startswith("/") else address.strip().upper()
    return Path(tempfile.gettempdir()) / _FOLDER / hashlib.sha256(one.encode()).hexdigest()[:32]


def _opened(path: Path) -> int:
    """Open a lock's file, made if need be so that other users may open it too."""
    with suppress(FileExistsError):
        path.parent.mkdir()
        path.parent.chmod(0o1777)
    # In two steps: Linux refuses to "create" a file that is there already and is another user's.
    with suppress(FileExistsError):
        made = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC)
        os.fchmod(made, 0o666)
        return made
    return os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)


def _self(role: str) -> dict[str, Any]:
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])[:_LONGEST_COMMAND]
    since = RealClock().wall().isoformat(timespec="seconds")
    return {"pid": os.getpid(), "command": command, "role": role, "since": since}


def _holder(said: bytes) -> str:
    """Say who holds a lock; one that has only just taken it may not have written its name yet."""
    try:
        who = json.loads(said)
        return f"process {who['pid']} ({who['command']}) as {who['role']} since {who['since']}"
    except (ValueError, KeyError, TypeError):
        return "another program"
