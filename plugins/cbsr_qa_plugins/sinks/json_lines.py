"""Events as lines of JSON in a file that is rotated by size."""

import fcntl
import json
import os
import stat
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final

from pydantic import AfterValidator, Field

from cbsr_qa.config.paths import var_folder
from cbsr_qa.plugin import DeliveryError, PluginOptions, WithOptions
from cbsr_qa_plugins.sinks._options import check_template, fill_template

#: Without O_NONBLOCK a named pipe that nobody reads would hang.
_APPEND: Final = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK | os.O_CLOEXEC


class JsonLines(WithOptions):
    """Appends each event to a file, as one line of JSON.

    Several runs may write to one file at a time. What could not be written whole is taken back.

    Parameters
    ----------
    path : file, relative to `CBSR_QA_VAR`; may have the fields {station}, {serial} and {run}.
    largest_MB : a file that would grow larger is renamed to PATH.1 first, an earlier PATH.1 to PATH.2, and so on.
    kept : number of renamed files; older ones are deleted.
    """

    class Options(PluginOptions):
        path: Annotated[str, AfterValidator(check_template)] = "events/{station}.jsonl"
        largest_MB: Annotated[float, Field(ge=0.001, le=100_000)] = 100.0
        kept: Annotated[int, Field(ge=0, le=1000)] = 5

    options: Options
    largest_batch: ClassVar[int] = 1000

    def deliver(self, messages: Sequence[Mapping[str, Any]]) -> None:
        path = var_folder() / fill_template(self.options.path, messages[0])
        lines = "".join(f"{json.dumps(message, separators=(',', ':'))}\n" for message in messages).encode()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = self._open_file(path, len(lines))
            try:
                _append(file, lines)
            finally:
                os.close(file)
        except OSError as error:
            raise DeliveryError(
                f"{path} cannot be written: {error.strerror or error}", remedy="free it, or name another path"
            ) from error

    def close(self) -> None:
        """Nothing stays open between deliveries."""

    def _open_file(self, path: Path, size: int) -> int:
        """Open and lock the file, after renaming one that has no room for so many bytes."""
        while True:
            file = os.open(path, _APPEND, 0o644)
            try:
                if not stat.S_ISREG(os.fstat(file).st_mode):
                    raise OSError("it is not a regular file")
                fcntl.flock(file, fcntl.LOCK_EX)
                status = os.fstat(file)
                try:
                    has_its_name = os.path.samestat(path.stat(), status)
                except FileNotFoundError:
                    has_its_name = False
                if has_its_name:  # otherwise another run has renamed it meanwhile
                    if not status.st_size or status.st_size + size <= self.options.largest_MB * 1e6:
                        return os.dup(file)
                    self._rotate(path)
            finally:
                os.close(file)

    def _rotate(self, path: Path) -> None:
        old_files = [path.with_name(f"{path.name}.{number}") for number in range(1, self.options.kept + 1)]
        for older, newer in zip(reversed(old_files), reversed([path, *old_files[:-1]]), strict=True):
            with suppress(FileNotFoundError):
                newer.replace(older)
        if not old_files:
            path.unlink()


def _append(file: int, lines: bytes) -> None:
    size = os.fstat(file).st_size
    if size and os.pread(file, 1, size - 1) != b"\n":
        lines = b"\n" + lines  # a power cut left half a line
    try:
        while lines:
            lines = lines[os.write(file, lines) :]
    except OSError:
        with suppress(OSError):
            os.ftruncate(file, size)
        raise
