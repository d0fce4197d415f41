"""Forced end of a process when a plugin's code catches every request to stop."""

import os
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Final

_MESSAGE: Final = b"cbsr-qa: a plugin does not stop: this process ends at once; everything measured is stored\n"

_watched: list[int] = []


def be_watched() -> None:
    """Note that another process waits for this one, and reports how it ended."""
    _watched[:] = [os.getpid()]


def end_later(after_s: float) -> Callable[[], None]:
    """Kill this process after a time if another one waits for it; return a function that prevents it.

    Nothing happens in a process without a watcher, such as a notebook's.
    """
    if os.getpid() not in _watched:
        return lambda: None
    timer = threading.Timer(after_s, _kill_process)
    timer.daemon = True
    timer.start()
    return timer.cancel


def _kill_process() -> None:
    with suppress(OSError):
        os.write(2, _MESSAGE)
    os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))
