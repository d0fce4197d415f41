"""Progress of work that is counted, only on stderr: on a terminal a bar, elsewhere one line a stage."""

import sys
from contextlib import suppress
from typing import Self, TextIO


class Counting:
    """Shows stages, and how much of one is done. Use it as a context manager; leaving it takes the bar away.

    Parameters
    ----------
    what : that is counted, e.g. ``"frames"``.
    stream : where to; by default the process's stderr.
    """

    def __init__(self, what: str, *, stream: TextIO | None = None) -> None:
        self._what = what
        self._stream = stream or sys.stderr
        self._bar: _Bar | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def stage(self, name: str) -> None:
        """Begin a stage."""
        self._close()
        print(f"{name} …", file=self._stream, flush=True)

    def count(self, done: int, of: int) -> None:
        """Say how much of the stage is done."""
        if self._bar is None and self._stream.isatty():
            self._bar = _Bar(self._what, self._stream)
        if self._bar is not None:
            self._bar.show(done, of)

    def _close(self) -> None:
        if self._bar is not None:
            bar, self._bar = self._bar, None
            with suppress(OSError):  # the terminal may be gone before the work is done
                bar.close()


class _Bar:
    """The bar on a terminal; rich is imported only for it."""

    def __init__(self, what: str, stream: TextIO) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (BarColumn(bar_width=24), MofNCompleteColumn(), TextColumn(what), TimeRemainingColumn())
        self._bar = Progress(*columns, console=Console(file=stream), transient=True)
        self._task = self._bar.add_task(what, total=None)
        self._bar.start()

    def show(self, done: int, of: int) -> None:
        """Show what is done."""
        self._bar.update(self._task, completed=done, total=of)

    def close(self) -> None:
        """Take the bar away."""
        self._bar.stop()
