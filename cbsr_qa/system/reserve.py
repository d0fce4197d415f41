"""Memory that is set aside, so that a program that has none left can still end in order."""

import mmap
from contextlib import suppress
from typing import Final

#: Size of the reserve: stacks of the threads that stop instruments, and the journal's needs [B of address space].
_BYTES: Final = 96 * 2**20


class MemoryReserve:
    """Address space that holds no page, so that it costs nothing until it is given back."""

    def __init__(self) -> None:
        self._set_aside: mmap.mmap | None = None
        with suppress(OSError, ValueError, MemoryError):  # less memory is left: nothing can be set aside
            self._set_aside = mmap.mmap(-1, _BYTES)

    def give_back(self) -> None:
        """Return the memory to the program; may be called more than once."""
        if self._set_aside is not None:
            self._set_aside.close()
