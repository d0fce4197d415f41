"""Ctrl-C, termination and hang-up during a run: heard once, never in the middle of a commit or of stopping."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Final, Self

_NAMES: Final = ("SIGINT", "SIGTERM", "SIGHUP")  # the last is unknown on Windows


class Stopped(KeyboardInterrupt):
    """A signal asked the run to stop; not an ``Exception``, so that no driver's ``except`` swallows it."""

    def __init__(self, by: str) -> None:
        super().__init__(f"stopped by {by}")
        self.by = by


class Interrupts:
    """While entered, signals end the run by an exception at a moment when nothing can be torn.

    The first signal raises where the run is, or after the document being delivered; a second one breaks
    through a delivery that hangs. From :meth:`mask` on every signal is ignored: the bench is being made safe,
    and an impatient second Ctrl-C must not leave the head down. Handlers the application installed are called;
    where there is none the signal raises :class:`Stopped`. A signal the process inherited as ignored (SIGHUP under
    nohup, SIGINT in a script's background) stays ignored: whoever started it wanted that. Outside the main thread
    nothing is installed, because Python delivers no signals there.
    """

    def __init__(self) -> None:
        self._before: dict[signal.Signals, Any] = {}
        self._masked = False
        self._delivering = False
        self._pending: signal.Signals | None = None

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]:
                if signal.getsignal(number) not in (signal.SIG_IGN, None):  # None: not set from Python
                    self._before[number] = signal.signal(number, self._heard)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def mask(self) -> None:
        """Ignore signals from here on."""
        self._masked = True

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """Let a signal wait until what is inside has been done."""
        self._delivering = True
        try:
            yield
        finally:
            self._delivering = False
        if self._pending is not None and not self._masked:
            self._raise(self._pending)

    def _heard(self, number: int, _: FrameType | None) -> None:
        if self._masked:
            return
        if self._delivering and self._pending is None:
            self._pending = signal.Signals(number)
            return
        self._raise(signal.Signals(number))

    def _raise(self, number: signal.Signals) -> None:
        self._masked = True
        before = self._before[number]
        if callable(before):
            before(number, None)
        raise Stopped(f"signal {number.name}")
