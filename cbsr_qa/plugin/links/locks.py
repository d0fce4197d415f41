"""Exclusive access to an instrument: a lock per port or resource, which names its holder."""

import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.system.clock import RealClock
from cbsr_qa.system.files import FileLock, HeldError
from cbsr_qa.system.json_text import parse_json

#: Below the computer's directory for temporary files, so that programs of all its users meet there.
_FOLDER: Final = "cbsr-qa-locks"
_PROGRAM: Final = "cbsr-qa"
_MAX_COMMAND_LENGTH: Final = 40


class AddressLock:
    """Holds an address until it is released or the process ends, however it ends.

    See ``FileLock``. A second instrument of the same program is refused like another program's.
    InstrumentError if it is held, naming the holder; or if its file cannot be created.

    Parameters
    ----------
    address : as the station file states it; paths of one device are one address, also through links to it.
    device : what is locked, if a device has several spellings of its address.
    """

    def __init__(self, role: str, address: str, *, device: str = "") -> None:
        path = lock_path(device or address)
        since = RealClock().wall().isoformat(timespec="seconds")
        own_name = {"pid": os.getpid(), "command": _name_command(sys.argv), "role": role, "since": since}
        try:
            with suppress(FileExistsError):
                path.parent.mkdir()
                path.parent.chmod(0o1777)
            # Every user's program may read who holds it, and take over the file of one that was killed.
            self._lock = FileLock(path, json.dumps(own_name).encode(), shared=True)
        except HeldError as error:
            who = _read_holder(error.who)
            reason, remedy = f"it is in use by {_describe_holder(who)}", "end that program, or wait for it"
            if who.get("pid") == os.getpid():
                reason = f"{who['role']!r} of this program has the same address"
                remedy = "give each instrument its own address"
            raise InstrumentError(role, address, reason, remedy=remedy) from error
        except OSError as error:
            reason = f"it cannot be locked against a second program: {error}"
            raise InstrumentError(role, address, reason, remedy=f"let this user write in {path.parent}") from error

    def release(self) -> None:
        """Let others have it; may be called more than once."""
        self._lock.release()


def lock_path(address: str) -> Path:
    """File that is locked for an address."""
    resolved = str(Path(address).resolve()) if address.startswith("/") else address.strip().upper()
    return Path(tempfile.gettempdir()) / _FOLDER / hashlib.sha256(resolved.encode()).hexdigest()[:32]


def _name_command(words: Sequence[str]) -> str:
    """Name a program and its command alone: every user reads this, and what follows may be a password."""
    program, command = [Path(words[0]).name, *words[1:], ""][:2]
    is_command = program == _PROGRAM and not command.startswith("-")
    return f"{program} {command if is_command else ''}".strip()[:_MAX_COMMAND_LENGTH]


def _read_holder(text: bytes) -> dict[str, Any]:
    """Read what names the holder of a lock; empty if it has not written its name yet."""
    try:
        who = parse_json(text)
    except ValueError:
        return {}
    kinds = {"pid": int, "command": str, "role": str, "since": str}
    is_named = isinstance(who, dict) and {key: type(value) for key, value in who.items()} == kinds
    return who if is_named and "".join(map(str, who.values())).isprintable() else {}


def _describe_holder(who: Mapping[str, Any]) -> str:
    if not who:
        return "another program"
    return f"process {who['pid']} ({who['command']}) as {who['role']} since {who['since']}"
