"""Repetition of signals whose exception Python drops.

Python prints and drops what a signal's handler raises while a weak reference's callback or a ``__del__`` runs
(``sys.unraisablehook``); HDF5's handles and pools of connections have many of those. Without this a Ctrl-C is lost.
"""

import os
import signal
import sys
import threading
from types import TracebackType
from typing import Any, Final, Self

#: Delay of the second delivery: by then the callback has ended [s].
_LATER_S: Final = 0.02


class Redelivery:
    """While entered, in the main thread, a dropped ``KeyboardInterrupt`` makes its signal come again.

    The handlers are not replaced. A handler that raises only once asks :meth:`was_dropped` whether to raise again.
    """

    def __init__(self) -> None:
        #: The signal that comes again; a handler for another than Ctrl-C sets it before it raises.
        self.number: int = signal.SIGINT
        self._process = os.getpid()
        self._dropped = False
        self._due: threading.Timer | None = None
        self._before: Any = None

    def was_dropped(self) -> bool:
        """Whether an exception raised by a handler was dropped; true once for every loss."""
        dropped, self._dropped = self._dropped, False
        return dropped

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._before, sys.unraisablehook = sys.unraisablehook, self._hear
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Raise pending signals, unless another error propagates."""
        if self._before is not None:
            sys.unraisablehook, self._before = self._before, None
        timer, self._due = self._due, None
        if timer is not None:
            timer.cancel()
            if error is None:
                raise KeyboardInterrupt

    def _hear(self, lost: "sys.UnraisableHookArgs") -> None:
        if os.getpid() != self._process:  # a copy that a plugin forked stays silent
            return
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            self._before(lost)
            return
        self._dropped = True
        # Not from here: the handler would raise within this hook, where Python drops exceptions as well.
        self._due = threading.Timer(_LATER_S, self._redeliver)
        self._due.daemon = True
        self._due.start()

    def _redeliver(self) -> None:
        timer, self._due = self._due, None
        main_thread = threading.main_thread().ident
        if timer is None or main_thread is None:
            return
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(main_thread, self.number)  # also wakes what waits in C
        else:
            signal.raise_signal(self.number)
