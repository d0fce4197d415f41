"""Independent pieces of work, shared with a forked helper where the computer has a second processor."""

import gc
import multiprocessing
import os
import pickle
import signal
import struct
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Final, TypeVar

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
    alone = multiprocessing.parent_process() is None  # workers of a study have filled the processors
    if CONTAINED and alone and 1 < len(tasks) <= _MOST and len(os.sched_getaffinity(0)) > 1:
        with suppress(OSError):  # no process or pipe is left: all are called here
            found = _shared(tasks)
    return [found[number] if number in found else task() for number, task in enumerate(tasks)]


def _shared(tasks: Sequence[Callable[[], Result]]) -> dict[int, Result]:
    waiting, given = os.pipe()
    os.write(given, b"".join(map(_NUMBER.pack, range(len(tasks)))))
    os.close(given)
    incoming, outgoing = os.pipe()
    with os.fdopen(incoming, "rb") as pipe:
        helper = _helper(tasks, waiting, outgoing)
        os.close(outgoing)
        try:
            found: dict[int, Result] = {}
            while (number := _next(waiting)) is not None:
                with suppress(Exception):  # raised when it is called again, the first of all tasks first
                    found[number] = tasks[number]()
            with suppress(EOFError, pickle.UnpicklingError):
                found |= {taken: pickle.loads(result) for taken, result in pickle.load(pipe).items()}
        finally:
            os.kill(helper, signal.SIGKILL)  # it has sent all, or its reader has ended
            os.waitpid(helper, 0)
            os.close(waiting)
    return found


def _next(waiting: int) -> int | None:
    number = os.read(waiting, _NUMBER.size)
    return _NUMBER.unpack(number)[0] if number else None


def _helper(tasks: Sequence[Callable[[], object]], waiting: int, outgoing: int) -> int:
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
        done = {}
        while (number := _next(waiting)) is not None:
            with suppress(Exception):
                done[number] = pickle.dumps(tasks[number]())
        with os.fdopen(outgoing, "wb") as pipe:
            pickle.dump(done, pipe)
    finally:
        os._exit(0)
