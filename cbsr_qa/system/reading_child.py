"""The child that reads one untrusted file: its limits, and the message that it sends to its parent."""

import codecs
import errno
import faulthandler
import os
import pickle
import signal
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.system.copies import end_forked_copies

_MEGABYTE: Final = 2**20
#: Processor time for any file, and more for each megabyte [s]; a megabyte of text takes 1 to 2 s.
_SECONDS: Final = 8.0
SECONDS_PER_MB: Final = 10.0
#: Factor from processor time to time on the clock: others may need the computer at the same time.
_CLOCK_FACTOR: Final = 6.0
#: Memory beyond the program's own [B], and more for each byte of the file, up to half of the computer's.
_MEMORY: Final = 2**30
_MEMORY_PER_BYTE: Final = 16
#: Number of files a reader has open at once: its own. Links of an HDF5 file would need a second one.
OPEN_FILES: Final = 1
#: Codecs looked up beforehand: Python imports them on first use, and a child may open no other file.
_CODECS: Final = (
    "ascii",
    "cp437",
    "latin-1",
    "utf-8",
    "utf-8-sig",
    "utf-16",
    "utf-16-le",
    "utf-16-be",
    "utf-32",
    "cp1252",
)
#: Length of each part of a message [B].
LENGTH: Final = struct.Struct("<Q")


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of reading one file."""

    seconds: float
    memory_bytes: int
    open_files: int = OPEN_FILES

    @property
    def clock_s(self) -> float:
        """Limit of wall time [s]."""
        return _CLOCK_FACTOR * self.seconds

    @classmethod
    def from_size(
        cls, size_bytes: int, seconds_per_mb: float = SECONDS_PER_MB, open_files: int = OPEN_FILES
    ) -> "Limits":
        """Return the limits for a file size; larger files may take more time and memory."""
        half_of_memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
        memory_bytes = _MEMORY + min(_MEMORY_PER_BYTE * size_bytes, half_of_memory)
        return cls(_SECONDS + seconds_per_mb * size_bytes / _MEGABYTE, memory_bytes, open_files)


def send_result(outgoing: int, *, pickled: bytes, limits: Limits) -> None:
    """Read in the child, and send the result."""
    for codec in _CODECS:
        codecs.lookup(codec)
    try:
        reader: Callable[[], Any] = pickle.loads(pickled)  # imports the modules it needs
    except Exception as error:  # noqa: BLE001 - the parent says it
        reader = partial(_raise, error)
    outgoing = _confine(outgoing, limits)
    with os.fdopen(outgoing, "wb", closefd=False) as pipe:
        for part in _message(reader, limits):
            pipe.write(LENGTH.pack(memoryview(part).nbytes))
            pipe.write(part)


def _confine(outgoing: int, limits: Limits) -> int:
    """Release all that reading does not need in the child; return the pipe's new descriptor."""
    import resource

    faulthandler.disable()
    for signal_number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(signal_number, signal.SIG_DFL)
    null_device = os.open(os.devnull, os.O_RDWR)
    for standard in range(3):
        os.dup2(null_device, standard)
    os.dup2(outgoing, 3)
    os.closerange(4, max(resource.getrlimit(resource.RLIMIT_NOFILE)[0], 2**16))
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit_by_kind = {
        resource.RLIMIT_AS: pages * resource.getpagesize() + limits.memory_bytes,
        resource.RLIMIT_CPU: int(limits.seconds) + 1,
        resource.RLIMIT_NOFILE: 4 + limits.open_files,
        resource.RLIMIT_FSIZE: 0,
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_NPROC: 0,
    }
    for resource_kind, limit in limit_by_kind.items():
        hard_limit = resource.getrlimit(resource_kind)[1]
        new_limit = limit if hard_limit == resource.RLIM_INFINITY else min(limit, hard_limit)
        # A second later the kernel kills without saying why.
        resource.setrlimit(
            resource_kind, (new_limit, hard_limit if resource_kind == resource.RLIMIT_CPU else new_limit)
        )
    return 3


def _raise(error: Exception) -> None:
    raise error


def _message(read: Callable[[], Any], limits: Limits) -> list[Any]:
    """Encode the result of reading: a pickled head, and the arrays' bytes."""
    arrays: list[pickle.PickleBuffer] = []
    try:
        with end_forked_copies():  # a format may be a plugin
            outcome: tuple[Any, ...] = ("read", read())
    except MemoryError:
        outcome = ("memory",)
    except Exception as error:  # noqa: BLE001 - the parent says it
        outcome = _encode_failure(error)
    try:
        head = pickle.dumps(outcome, protocol=5, buffer_callback=arrays.append)
        return [head, *(array.raw() for array in arrays)]
    except MemoryError:
        return [pickle.dumps(("memory",))]
    except Exception as error:  # noqa: BLE001 - a format may return anything
        return [pickle.dumps(("strange", str(error)))]


def _encode_failure(error: Exception) -> tuple[Any, ...]:
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno == errno.EMFILE:
            return "second", None if cause.filename is None else str(cause.filename)
        cause = cause.__cause__ or cause.__context__
    if isinstance(error, RefusedError):
        problems = tuple(getattr(error, "problems", ()))
        return "refused", type(error).__name__, error.reason, error.remedy, problems
    return "broken", f"{type(error).__name__}: {error}"
