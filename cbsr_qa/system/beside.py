"""Independent pieces of work, shared with a forked helper where the computer has a second processor."""

import gc
import mmap
import multiprocessing
import os
import pickle
import signal
import struct
import warnings
import weakref
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Final, Generic, TypeVar

from cbsr_qa.system.untrusted import CONTAINED

Result = TypeVar("Result")

#: A task's number in the pipe that hands out the next one; more tasks than fit into a pipe at once are not shared.
_NUMBER: Final = struct.Struct("<H")
_MOST: Final = 1000


def side_by_side(tasks: Sequence[Callable[[], Result]]) -> list[Result]:
    """Call functions that do not depend on each other; return their results in order.

    A forked helper and this process each take the next one until none is left. What the helper does not return, since
    it failed, was killed or made what cannot be pickled, is called here: results and errors are those of calling all
    of them one by one, on any number of processors.

    Parameters
    ----------
    tasks : that change nothing which others see; whatever a helper changes is lost.
    """
    found: dict[int, Result] = {}
    if 1 < len(tasks) <= _MOST and _has_room():
        with suppress(OSError):  # no process or pipe is left: all are called here
            found = _share_tasks(tasks)
    return [found[number] if number in found else task() for number, task in enumerate(tasks)]


def _has_room() -> bool:
    alone = multiprocessing.parent_process() is None  # workers of a study have filled the processors
    return CONTAINED and alone and len(os.sched_getaffinity(0)) > 1


def _share_tasks(tasks: Sequence[Callable[[], Result]]) -> dict[int, Result]:
    waiting, given = os.pipe()
    os.write(given, b"".join(map(_NUMBER.pack, range(len(tasks)))))
    os.close(given)
    incoming, outgoing = os.pipe()
    with os.fdopen(incoming, "rb") as pipe:
        helper = _helper(tasks, waiting, outgoing)
        os.close(outgoing)
        try:
            found: dict[int, Result] = {}
            while (number := _take_number(waiting)) is not None:
                with suppress(Exception):  # raised when it is called again, the first of all tasks first
                    found[number] = tasks[number]()
            with suppress(EOFError, pickle.UnpicklingError):
                found |= {taken: pickle.loads(result) for taken, result in pickle.load(pipe).items()}
        finally:
            os.kill(helper, signal.SIGKILL)  # it has sent all, or its reader has ended
            os.waitpid(helper, 0)
            os.close(waiting)
    return found


def _take_number(waiting: int) -> int | None:
    number = os.read(waiting, _NUMBER.size)
    return _NUMBER.unpack(number)[0] if number else None


def _helper(tasks: Sequence[Callable[[], object]], waiting: int, outgoing: int) -> int:
    def work() -> None:
        done = {}
        while (number := _take_number(waiting)) is not None:
            with suppress(Exception):
                done[number] = pickle.dumps(tasks[number]())
        with os.fdopen(outgoing, "wb") as pipe:
            pickle.dump(done, pipe)

    return _fork_helper(work)


def _fork_helper(work: Callable[[], None]) -> int:
    """Do something in a helper, which then ends; return its process number."""
    with warnings.catch_warnings():
        # Newer Pythons warn of threads that hold locks. Ours only wait.
        warnings.simplefilter("ignore", DeprecationWarning)
        helper = os.fork()
    if helper:
        return helper
    try:
        gc.disable()  # finalisers of what the parent holds are the parent's
        signal.set_wakeup_fd(-1)  # the parent reports signals
        for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            signal.signal(each, signal.SIG_DFL)
        work()
    finally:
        os._exit(0)


class Ahead(Generic[Result]):
    """A function that a forked helper calls while this process continues.

    What the helper does not return is called here when it is asked for, as by :func:`side_by_side`. Begin before
    devices, databases and locks are open: the helper holds what is open until it has done.

    Parameters
    ----------
    task : that changes nothing which others see; whatever it changes is lost.
    """

    def __init__(self, task: Callable[[], Result]) -> None:
        self._task = task
        self._result: list[Result] = []
        self._ended: weakref.finalize[..., Ahead[Result]] | None = None
        if _has_room():
            with suppress(OSError):  # no process, pipe or memory is left: called here
                self._begin()

    def _begin(self) -> None:
        kept = os.memfd_create("cbsr-qa")  # holds a result of any size, so that the helper need not wait for a reader
        ended, working = os.pipe()

        def work() -> None:
            with os.fdopen(kept, "wb") as file:
                pickle.dump(self._task(), file)

        helper = _fork_helper(work)
        os.close(working)  # closed everywhere once the helper has ended
        self._kept, self._working = kept, ended
        self._ended = weakref.finalize(self, _end, os.getpid(), helper, kept, ended)  # nobody may ask for the result

    def result(self) -> Result:
        """Wait for the result; the same object every time. Raises what the function raises."""
        if not self._result:
            self._result.append(self._task() if self._ended is None else self._read_result(self._ended))
        return self._result[0]

    def _read_result(self, end: Callable[[], object]) -> Result:
        try:
            os.read(self._working, 1)
            # Not read: where a file is read is shared with the helper's other readers.
            with mmap.mmap(self._kept, 0, access=mmap.ACCESS_READ) as pickled:
                result: Result = pickle.loads(pickled)
        except (EOFError, OSError, ValueError, pickle.UnpicklingError):  # ValueError: nothing was written
            result = self._task()
        finally:
            end()
        return result


def _end(owner: int, helper: int, *files: int) -> None:
    """End a helper, if this process began it, and close what it wrote to."""
    if owner == os.getpid():
        os.kill(helper, signal.SIGKILL)  # it has ended, or nobody asks any more
        os.waitpid(helper, 0)
    for each in files:
        os.close(each)
