"""Atomic file writes, tables that spreadsheets open safely, and lock files of one process."""

import csv
import errno
import io
import os
import secrets
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.system.foreign import check_status

if sys.platform == "win32":  # untested
    import msvcrt

    def _lock(file: int) -> None:
        os.lseek(file, _LOCKED_BYTE, os.SEEK_SET)  # beyond the text in it, which others may read
        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)

    def _unlock(file: int) -> None:
        os.lseek(file, _LOCKED_BYTE, os.SEEK_SET)
        msvcrt.locking(file, msvcrt.LK_UNLCK, 1)

else:
    import fcntl

    def _lock(file: int) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _unlock(file: int) -> None:
        fcntl.flock(file, fcntl.LOCK_UN)


_LOCKED_BYTE: Final = 1 << 20
_MAX_HOLDER_BYTES: Final = 4096  # longest description of a holder in a file [bytes]
_MAX_TRIES: Final = 1000  # attempts to lock a file that others remove; some file systems never find it
#: Longest time for which a holder may have no name in its file: it is about to write it, or removes the file [s].
_NAMELESS_S: Final = 0.1


class HeldError(Exception):
    """The lock is held by this or another process; ``who`` is the text in its file, at first empty."""

    def __init__(self, who: bytes) -> None:
        super().__init__(who)
        self.who = who


#: Descriptors of the locks that this process holds.
_held: Final[set[int]] = set()


def _close_in_copy() -> None:
    """Close a forked copy's descriptors of locks: it would keep them locked after this process is killed."""
    for file in _held:
        with suppress(OSError):
            os.close(file)
    _held.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_close_in_copy)


class FileLock:
    """Holds a file's lock until it is released or the process ends.

    The kernel keeps the lock, and no process that this one starts or forks has it, so the file of a killed process
    blocks no one: the next holder takes it over and removes it. A file that belongs to another user may stay where
    only its owner may remove it. HeldError if it is held by a process that wrote a name or has held it for
    :data:`_NAMELESS_S`; OSError if the file cannot be made, or ``who`` not be written in it. ``path``: path of the
    file; its folder exists.
    """

    def __init__(self, path: Path, who: bytes, *, shared: bool = False) -> None:
        self._path = path
        self._process = os.getpid()
        self._file: int | None = None
        begun_s = time.monotonic()
        for _ in range(_MAX_TRIES):
            try:
                self._file = _open_locked(path, shared=shared)
            except HeldError as error:
                if error.who or time.monotonic() - begun_s > _NAMELESS_S:
                    raise
                time.sleep(0.001)
            if self._file is not None:
                break
        else:
            raise OSError(errno.ENOENT, "a file created there disappears at once", str(path))
        _held.add(self._file)
        try:
            os.ftruncate(self._file, 0)
            os.lseek(self._file, 0, os.SEEK_SET)
            os.write(self._file, who)
        except OSError:
            self.release()
            raise

    def release(self) -> None:
        """Remove the file and release the lock; may be called more than once, and does nothing in a forked copy."""
        file, self._file = self._file, None
        if file is None or os.getpid() != self._process:
            return
        try:
            with suppress(OSError):
                os.ftruncate(file, 0)
            with suppress(OSError):
                self._path.unlink()
            # Unlocked explicitly: a copy that a library's C code forked would keep the lock.
            with suppress(OSError):
                _unlock(file)
        finally:
            _held.discard(file)
            os.close(file)


def holder(path: Path) -> bytes | None:
    """Return the text in the holder's file; None if the lock is free.

    The file of a process that was killed is removed, if this user may remove it. Nothing is written, so a full disk
    does not matter.
    """
    try:
        file = os.open(path, os.O_RDONLY | _SAFE)
    except OSError:  # missing, or not readable by this user
        return None
    try:
        check_status(path, os.fstat(file))
        _lock(file)
        if _is(file, path):
            path.unlink()
    except BlockingIOError:
        return _read_holder(file)
    except OSError:
        return None
    finally:
        os.close(file)
    return None


#: Flags of opening a lock in a shared folder: it may be another user's link to a file of this user, or a pipe.
_SAFE: Final = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)


def _open_locked(path: Path, *, shared: bool) -> int | None:
    """Open and lock the file; None if its holder removed it in between."""
    try:
        file = _open_or_create(path, shared=shared)
    except FileNotFoundError:
        if not path.parent.is_dir():
            raise
        return None
    try:
        check_status(path, os.fstat(file))
    except OSError:
        os.close(file)
        raise
    try:
        _lock(file)
    except OSError as error:
        holder_text = _read_holder(file)
        os.close(file)
        raise HeldError(holder_text) from error
    if _is(file, path):
        return file
    os.close(file)
    return None


def _open_or_create(path: Path, *, shared: bool) -> int:
    # In two steps: Linux refuses to "create" an existing file of another user.
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    except FileExistsError:
        return os.open(path, os.O_RDWR | _SAFE)
    if shared:
        os.chmod(file, 0o666)  # noqa: PTH101 - by descriptor: the path may be another's file by now
    return file


def _read_holder(file: int) -> bytes:
    os.lseek(file, 0, os.SEEK_SET)
    return os.read(file, _MAX_HOLDER_BYTES).strip()


def _is(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), path.stat(follow_symlinks=False))
    except OSError:
        return False


#: Characters that begin a formula in a spreadsheet.
_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r")


@contextmanager
def writing(path: Path, *, refusal: type[RefusedError] = RefusedError, remedy: str = "") -> Iterator[None]:
    """Turn an operating system error in writing ``path`` into a refusal that names path and cause."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        if isinstance(error, FileExistsError):  # a file is in the place of a folder
            reason = f"{error.filename} is a file, not a folder"
        if isinstance(error, PermissionError):
            remedy = remedy or "allow writing there, or name another file"
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            remedy = "make room on that disk, or name a place on another"
        raise refusal(f"{path} cannot be written: {reason}", remedy=remedy) from error


@contextmanager
def write_atomically(path: Path) -> Iterator[BinaryIO]:
    """Write to a temporary file in the same folder; it replaces ``path`` when the block ends without an error.

    The mode is 0666 less the umask, which the kernel applies as it creates the file: asking for the umask means
    setting it, for all threads at once. OSError if anything cannot be written; ``path`` is then as it was, and the
    temporary file is gone.
    """
    temporary = path.parent / f".{secrets.token_hex(8)}.partial"
    try:
        with temporary.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        with suppress(OSError):
            temporary.unlink()


def csv_text(rows: Iterable[Iterable[str | float | None]], *, line_end: str = "\n") -> str:
    """Write rows as CSV: text in UTF-8, numbers to their last digit, nothing for None.

    RFC 4180 wants lines that end with CR and LF; those of our tables of numbers end with LF.

    An apostrophe goes before text that begins with ``= + - @``, a tab or a carriage return: spreadsheets would
    evaluate it as a formula (OWASP, CSV injection). Numbers stay as they are. Halves of characters, which names of
    files may hold, are escaped.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator=line_end)
    for row in rows:
        cells = list(row)
        for column, value in enumerate(cells):
            if isinstance(value, str):
                escaped = value.encode("utf-8", "backslashreplace").decode()
                cells[column] = f"'{escaped}" if escaped.startswith(_FORMULA) else escaped
        writer.writerow(cells)
    return text.getvalue()
