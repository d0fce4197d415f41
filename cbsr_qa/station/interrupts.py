"""Signals and requests to stop a run: the first one stops it cleanly, the second at once."""

import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, Final, Self

from cbsr_qa.domain.run.states import EMERGENCY, SECOND_SIGNAL
from cbsr_qa.system.redelivery import Redelivery

#: Signals that end a run. Ctrl-Z and Ctrl-\ would suspend or kill the program with the head down. Windows knows two.
_NAMES: Final = ("SIGINT", "SIGTERM", "SIGHUP", "SIGTSTP", "SIGQUIT")

#: Messages on the first and on the second signal.
FIRST: Final = (
    "{}: the run stops: the current step is completed and stored, the head is lifted at its press speed,"
    " the bench is made safe. A second signal makes the bench safe at once."
)
SECOND: Final = "{}: making the bench safe at once. Further signals are ignored until it is safe."
#: Names of the first and the second signal where they are requests over the control channel.
_ASKED, _INSISTED = "stop asked for by {}", "emergency stop by {}"


class Stopped(KeyboardInterrupt):
    """A signal or a request asked the run to stop; not an ``Exception``, so no driver's ``except`` swallows it."""

    def __init__(self, by: str) -> None:
        super().__init__(f"stopped by {by}")
        self.by = by


def on_stderr(line: str) -> None:
    """Write a line past Python's buffers, which a signal may have interrupted."""
    with suppress(OSError, AttributeError, ValueError):  # no terminal, or a closed one
        os.write((sys.__stderr__ or sys.stderr).fileno(), f"{line}\n".encode())


class Interrupts:
    """While entered, signals end the run at a safe moment.

    The first signal is only remembered: :meth:`poll` raises it where the run may end, after every document and within
    :meth:`idle`. The second raises anywhere, also in a delivery or a hanging driver, and sets :attr:`urgent_by`. Both
    do so only within :meth:`listen`; outside, and after :meth:`mask`, nothing is raised: the bench is being made
    safe, which must not leave the head down. Handlers installed by the application identify the sender; without one
    the signal raises :class:`Stopped`. A signal inherited as ignored (SIGHUP under nohup, SIGINT in a script's
    background) stays ignored. Outside the main thread nothing is installed, because Python delivers no signals there.

    Parameters
    ----------
    tell : function called with the effect of a signal and of another one; not in a worker of a pool, whose parent
        received the same signal.
    """

    def __init__(self, tell: Callable[[str], None] = on_stderr) -> None:
        #: Cause that made the run end at once, not in order; empty without one.
        self.urgent_by = ""
        #: Function that says whether the run only waits, as in :meth:`idle`.
        self.waiting: Callable[[], bool] = lambda: False
        #: Function called on the first signal, to shorten the deadline of the current call.
        self.hurry: Callable[[], None] = lambda: None
        self._tell = tell if multiprocessing.parent_process() is None else lambda line: None
        self._redelivery = Redelivery()
        self._before: dict[signal.Signals, Any] = {}
        self._alarm_before: Any = None
        self._first: signal.Signals | str | None = None
        self._asked: deque[tuple[str, bool]] = deque()
        self._overdue: BaseException | None = None
        self._raised = False
        self._masked = False
        self._heard_now = False
        self._idle = False

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]:
                if signal.getsignal(number) not in (signal.SIG_IGN, None):  # None: not set from Python
                    self._before[number] = signal.signal(number, self._hear)
            if hasattr(signal, "SIGALRM"):
                self._alarm_before = signal.signal(signal.SIGALRM, self._broken_into)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if self._alarm_before is not None:
            signal.signal(signal.SIGALRM, self._alarm_before)

    def mask(self) -> None:
        self._masked = True

    @contextmanager
    def listen(self) -> Iterator[None]:
        """Let signals end the body; a signal during exit is raised to the caller."""
        self._heard_now = True
        try:
            with self._redelivery:
                yield
        finally:
            self._heard_now = False

    @contextmanager
    def idle(self) -> Iterator[None]:
        """Let the first signal end the body at once: it only waits."""
        self._idle = True
        try:
            self.poll()
            yield
        finally:
            self._idle = False

    @contextmanager
    def defer(self) -> Iterator[None]:
        """Let the first signal end the run after the body has finished."""
        yield
        self.poll()

    def poll(self) -> None:
        """Raise the first signal, if there was one: a point where the run may end.

        Raises Stopped, KeyboardInterrupt or AbortedError, naming the cause; once.
        """
        self._hear_asked()
        if self._first is not None and self._heard_now and not self._raised:
            self._raise()

    def ask_to_stop(self, by: str, *, at_once: bool = False) -> bool:
        """Stop the run as the first signal does, or at once as the second does; called from another thread.

        Returns whether it takes effect: not outside of :meth:`listen`.
        """
        if self._masked or not self._heard_now:
            return False
        self._asked.append((by, at_once))
        self._wake()
        return True

    def break_in(self, error: BaseException) -> None:
        """Raise an error in the main thread, wherever it hangs; called from another thread.

        Does nothing if no handler was installed. Wakes a call that waits in C if the system allows it.
        """
        self._overdue = error
        self._wake()

    def _wake(self) -> None:
        if self._alarm_before is not None:
            ident = threading.main_thread().ident
            assert ident is not None
            signal.pthread_kill(ident, signal.SIGALRM)

    def _hear(self, number: int, _: FrameType | None) -> None:
        if self._masked:
            return
        if self._redelivery.was_dropped():
            self._raise()  # Python dropped the earlier exception
        if self.urgent_by:
            return
        name = signal.Signals(number).name
        if self._first is None:
            self._stop_in_order(signal.Signals(number), name)
        elif self._heard_now:
            self._stop_at_once(name, SECOND_SIGNAL)

    def _hear_asked(self) -> None:
        while not (self._masked or self.urgent_by):
            try:
                asker, at_once = self._asked.popleft()
            except IndexError:  # empty, also if a signal's handler has just taken the last one
                return
            if at_once:
                self._first = asker if self._first is None else self._first
                self._stop_at_once(_INSISTED.format(asker), EMERGENCY.format(asker))
            elif self._first is None:
                self._stop_in_order(asker, _ASKED.format(asker))

    def _stop_in_order(self, first: signal.Signals | str, name: str) -> None:
        self._first = first
        self._tell(FIRST.format(name))
        self.hurry()
        if self._idle or self.waiting():
            self.poll()

    def _stop_at_once(self, name: str, by: str) -> None:
        self.urgent_by = by
        self._tell(SECOND.format(name))
        self._raise()

    def _broken_into(self, _: int, __: FrameType | None) -> None:
        if self._heard_now and not (self._masked or self.urgent_by) and self._overdue is not None:
            self._masked = True
            raise self._overdue
        if self._heard_now and not self._masked:
            if self._redelivery.was_dropped():
                self._raise()
            self._hear_asked()

    def _raise(self) -> None:
        self._raised = True
        assert self._first is not None
        if isinstance(self._first, str):
            self._redelivery.number = signal.SIGALRM
            raise Stopped(self._first)
        earlier_handler = self._before[self._first]
        self._redelivery.number = self._first
        if callable(earlier_handler):
            earlier_handler(self._first, None)
        raise Stopped(f"signal {self._first.name}")
