"""Copies of this process, which code of a plugin forks and lets come back: they end where they come back.

A copy holds what the process holds: the database, the station's lock, the instruments. It must neither store nor
print, and what it would clean up is not its own.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

#: Exit code of a copy, for a plugin that waits for it.
COPY_ENDED: Final = 70


@contextmanager
def come_back_once() -> Iterator[None]:
    """Call code of a plugin in the body; a copy of this process that comes back out of it ends, without clean-up."""
    process = os.getpid()
    try:
        yield
    finally:
        end_copy(process)


def end_copy(process: int) -> None:
    """End this process at once and silently, unless it is the given one."""
    if os.getpid() != process:
        os._exit(COPY_ENDED)
