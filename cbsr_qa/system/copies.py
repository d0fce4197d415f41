"""Copies of this process that a plugin's code forks: a copy that returns from that code ends there.

A copy holds what the process holds: the database, the station's lock, the instruments. It must neither store nor
print, and it must not clean up either: nothing there is its own.
"""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

#: Exit code of a copy, for a plugin that waits for it.
COPY_ENDED: Final = 70


@contextmanager
def end_forked_copies() -> Iterator[None]:
    """Call a plugin's code in the body; a forked copy of this process that returns from it ends without clean-up."""
    process = os.getpid()
    try:
        yield
    finally:
        end_copy(process)


def end_copy(process: int) -> None:
    """End this process at once and silently, unless it is the given one."""
    if os.getpid() != process:
        os._exit(COPY_ENDED)


def end_copies_of_threads() -> None:
    """From now on, a copy of this process that a thread forks ends, silently, where the thread's function returns.

    Such a copy has no caller to return to: Python would print a traceback, or crash, while it ends the thread. A copy
    that stays in the function, as a worker does, continues.
    """
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_end_with_thread)


def _end_with_thread() -> None:
    thread: Any = threading.current_thread()
    if not isinstance(thread, threading._MainThread):  # type: ignore[attr-defined]
        # The last calls of a thread, and the call after its function raised; there is no public way.
        thread._delete = thread._invoke_excepthook = lambda *_: os._exit(COPY_ENDED)
