"""Reading of untrusted files in a child process, so that a crash, hang or memory bomb cannot harm the parent.

Libraries that parse files (HDF5 above all) crash, loop or ask for gigabytes when a byte of a file is changed. So the
reader of a file is called in a child, whose memory, time and open files are limited; its result comes back as
plain data: dataclasses and enumerations of :mod:`cbsr_qa.domain`, numpy arrays, numbers and texts, and nothing else.
If a child dies, the file is refused, and the message names it. Children are forked by a process that
has nothing else open (:mod:`cbsr_qa.system.fork_server`), not by this one.

Only on Linux. Elsewhere the function is called directly, and only the bounds that readers put on sizes protect:
Windows cannot fork, and on macOS a fork of a process with the system's libraries is not safe.
"""

import io
import os
import pickle
import re
import select
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import is_dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar, cast

from cbsr_qa.domain import errors
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.system.foreign import UnfitFileError, open_foreign
from cbsr_qa.system.fork_server import obtain_fork_server
from cbsr_qa.system.reading_child import LENGTH, OPEN_FILES, SECONDS_PER_MB, Limits, send_result

Result = TypeVar("Result")

#: Whether files are read in a child process on this system.
CONTAINED: Final = sys.platform == "linux"
_MEGABYTE: Final = 2**20
#: Largest unpacked content of any file, and more for each of its bytes [B].
_CONTENT: Final = 16 * _MEGABYTE
_CONTENT_PER_BYTE: Final = 20
_COPY: Final = "the file is damaged: copy it again from where it was recorded or issued"
_BUSY: Final = (
    "the computer may be busy: try again when it is idle; if it fails again, the file holds too much or is damaged"
)
_TOO_MUCH: Final = (
    "it holds too much for its size: give a smaller one; if it is a sound file elsewhere, copy it again"
)
_PICKLED: Final = "a format's plugin is a class of a module that can be imported, and what it holds can be pickled"
#: Longest word, and longest message, that is repeated from a file [characters].
_MAX_WORD_LENGTH: Final = 200
_MAX_REASON_LENGTH: Final = 2000
#: Names that numpy needs to unpickle arrays and numbers.
_NUMPY: Final = {
    ("numpy", "dtype"),
    ("numpy", "ndarray"),
    ("numpy._core.numeric", "_frombuffer"),
    ("numpy.core.numeric", "_frombuffer"),
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy.core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"),
    ("numpy.core.multiarray", "scalar"),
}


def largest_content(size_bytes: int) -> int:
    """Return the largest content of a file, eight bytes per number: measured numbers hardly compress, fakes do."""
    return max(_CONTENT, _CONTENT_PER_BYTE * size_bytes)


def read_untrusted(
    path: Path,
    read: Callable[[], Result],
    *,
    refusal: type[RefusedError],
    seconds_per_mb: float = SECONDS_PER_MB,
    open_files: int = OPEN_FILES,
    modules: tuple[str, ...] = (),
) -> Result:
    """Call a function that reads a file in a child process, and return its result.

    RefusedError of the kind ``refusal`` if it is a pipe, device, socket or folder, or where reading crashes, hangs or
    takes too much memory; otherwise whatever error of :mod:`cbsr_qa.domain.errors` the function raises; RuntimeError
    if the function raises anything else: a defect of the reader, not of the file.

    Parameters
    ----------
    path : path of the file; the limits depend on its size, and refusals name it.
    read : function that reads the file, and raises a clear error if it is missing. While it has the file open, it
        can open no other, and it can write none. It is pickled: a function of a module, or a ``functools.partial``.
    refusal : type of the error raised where the child dies.
    seconds_per_mb : processor time for each megabyte, in addition to that of any file [s/MB].
    open_files : number of files that ``read`` may have open at once; more if its library opens the file twice.
    modules : modules of other packages to import beforehand: ``read`` cannot while its file is open.
    """
    size_bytes = _size(path, refusal)
    if not CONTAINED:
        try:
            return read()
        except RefusedError as error:
            problems = tuple(getattr(error, "problems", ()))
            raise _restore_error(type(error).__name__, error.reason, error.remedy, problems) from error
    limits = Limits.from_size(size_bytes, seconds_per_mb, open_files)
    try:
        pickled, own_modules = _pickle_reader(read)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise refusal(f"{path.name}: what reads it cannot be sent to a child: {error}", remedy=_PICKLED) from error
    task = pickle.dumps(partial(send_result, pickled=pickled, limits=limits))
    server = obtain_fork_server()
    incoming, outgoing = os.pipe()
    with os.fdopen(incoming, "rb", buffering=0) as pipe:
        try:
            child = server.fork(task, outgoing, (send_result.__module__, *own_modules, *modules))
        finally:
            os.close(outgoing)
        deadline = time.monotonic() + limits.clock_s
        try:
            received = _parts_of(pipe, deadline, limits)
        finally:
            status = server.end(child)  # the child has sent all, or has stopped
    if received is None:
        is_late = time.monotonic() >= deadline
        remedy = _BUSY if is_late else _TOO_MUCH if _ran_too_long(status) else _COPY
        raise refusal(_why(path, limits, status, late=is_late), remedy=remedy)
    return cast(Result, _result(path, received, limits, refusal))


def shorten(reason: str) -> str:
    """Return a message with quotes from the file cut: a name or unit may be a megabyte long."""
    shortened = re.sub(
        rf"\S{{{_MAX_WORD_LENGTH},}}", lambda found: f"{found[0][:60]}… ({len(found[0])} characters)", reason
    )
    return (
        shortened
        if len(shortened) <= _MAX_REASON_LENGTH
        else f"{shortened[:_MAX_REASON_LENGTH]}… ({len(shortened)} characters)"
    )


def _size(path: Path, refusal: type[RefusedError]) -> int:
    try:
        with open_foreign(path) as file:
            return os.fstat(file.fileno()).st_size
    except UnfitFileError as error:
        raise refusal(f"{path} cannot be read: {error.strerror}", remedy="name a file") from error
    except OSError:
        return 0  # the reader reports what is wrong


def _pickle_reader(read: Callable[[], Any]) -> tuple[bytes, list[str]]:
    """Pickle the function that a child calls; also return the modules of this package that it needs."""
    content = io.BytesIO()
    pickler = _ReaderPickler(content, protocol=5)
    pickler.dump(read)
    return content.getvalue(), sorted(pickler.modules)


class _ReaderPickler(pickle.Pickler):
    """Pickler that lists the modules of this package that its content comes from. A child imports the others."""

    def __init__(self, file: io.BytesIO, protocol: int) -> None:
        super().__init__(file, protocol)
        self.modules: set[str] = set()

    def reducer_override(self, obj: Any) -> Any:
        module = str(getattr(obj, "__module__", ""))
        if module.startswith(("cbsr_qa.", "cbsr_qa_plugins.")):
            self.modules.add(module)
        return NotImplemented


def _parts_of(pipe: io.FileIO, deadline: float, limits: Limits) -> list[bytearray] | None:
    """Return all parts a child sends before it ends; None on timeout, or if it stops within a part."""
    parts: list[bytearray] = []
    left_bytes = limits.memory_bytes
    while length := _receive(pipe, LENGTH.size, deadline):
        (count,) = LENGTH.unpack(length)
        if count > left_bytes:
            return None
        left_bytes -= count
        part = _receive(pipe, count, deadline)
        if part is None:
            return None
        parts.append(part)
    return parts if length is not None and parts else None


def _receive(pipe: io.FileIO, count: int, deadline: float) -> bytearray | None:
    """Read ``count`` bytes; empty at the end of the stream, None on timeout or if it ends within them."""
    data = bytearray(count)
    view, received = memoryview(data), 0
    while received < count:
        ready, _, _ = select.select([pipe], [], [], max(deadline - time.monotonic(), 0))
        read_count = pipe.readinto(view[received:]) if ready else None
        if not read_count:
            return bytearray() if read_count == 0 and received == 0 and count == LENGTH.size else None
        received += read_count
    return data


def _ran_too_long(status: int) -> bool:
    return os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU


def _why(path: Path, limits: Limits, status: int, *, late: bool) -> str:
    if late:
        return f"reading {path.name} took more than {limits.clock_s:.0f} s, the limit for a file of its size"
    if _ran_too_long(status):
        return (
            f"reading {path.name} took more than {limits.seconds:.0f} s of processor time, the limit for a file of"
            " its size"
        )
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) != signal.SIGKILL:
        name = signal.Signals(os.WTERMSIG(status)).name
        return f"the library that reads {path.name} crashed ({name})"
    return f"the process that was reading {path.name} ended before it was done"


def _result(path: Path, parts: list[bytearray], limits: Limits, refusal: type[RefusedError]) -> Any:
    try:
        kind, *content = _Plain(io.BytesIO(parts[0]), buffers=parts[1:]).load()
    except pickle.UnpicklingError as error:
        kind, content = "strange", [str(error)]
    if kind == "read":
        return content[0]
    if kind == "refused":
        raise _restore_error(*content)
    if kind == "memory":
        raise refusal(
            f"reading {path.name} needs more than {limits.memory_bytes / 2**30:.1f} GiB of memory, the limit for a"
            " file of its size",
            remedy=_TOO_MUCH,
        )
    if kind == "second":
        other_file = "another file" if content[0] is None else f"the file {shorten(content[0])}"
        raise refusal(
            f"reading {path.name} opens {other_file} beside it, which no recording or calibration needs",
            remedy="the file is damaged or links to other files; a plugin must import its modules beforehand",
        )
    if kind == "strange":
        raise refusal(
            f"{path.name}: its format plugin did not return a recording: {content[0]}",
            remedy="plugins return dataclasses of cbsr_qa.domain, numpy arrays, numbers and strings",
        )
    raise RuntimeError(f"reading {path.name}: {content[0]}")


def _restore_error(kind: str, reason: str, remedy: str, problems: tuple[Any, ...]) -> RefusedError:
    """Return the error a child raised; a plugin's own type becomes its base in this package."""
    error_type, reason = getattr(errors, kind, RefusedError), shorten(reason)
    if error_type is errors.RecordingError:
        return errors.RecordingError(reason, remedy=remedy, problems=problems)
    return cast(RefusedError, error_type(reason, remedy=remedy))


class _Plain(pickle.Unpickler):
    """Unpickler of plain data only: a child taken over by a file cannot make its parent call anything else."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in _NUMPY:
            return super().find_class(module, name)
        if (module, name) in (("pathlib", "PosixPath"), ("pathlib._local", "PosixPath")):
            return Path
        if module.startswith("cbsr_qa.domain.") and "." not in name:
            member = super().find_class(module, name)
            if isinstance(member, type) and (is_dataclass(member) or issubclass(member, Enum)):
                return member
        raise pickle.UnpicklingError(f"a {module}.{name}")
