"""Worker processes that compute with one thread each, and end with the process that began them."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Final

#: Environment variables from which numerical libraries take their number of threads when they are loaded.
_THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def worker_pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    """Begin worker processes; an error in the block, as by Ctrl-C, stops them in the middle of a piece of work."""
    # Spawned: threads of numerical libraries do not survive a fork.
    context = multiprocessing.get_context("spawn")
    earlier_children = multiprocessing.active_children()
    with _limit_threads(), ProcessPoolExecutor(processes, mp_context=context, initializer=_begin_worker) as pool:
        try:
            yield pool
        except BaseException:
            # In the middle of a piece of work, which may take minutes more.
            for worker in set(multiprocessing.active_children()) - set(earlier_children):
                worker.terminate()
            raise


@contextmanager
def delay_interrupts() -> Iterator[None]:
    """Block Ctrl-C while processes start: they inherit that, and ignore it while they import."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@contextmanager
def _limit_threads() -> Iterator[None]:
    earlier_values = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in earlier_values.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _begin_worker() -> None:
    """Leave Ctrl-C to the main process, and end with it: once killed, it cannot stop this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()


def _end_with(parent: int) -> None:
    never_set = threading.Event()
    while os.getppid() == parent:
        never_set.wait(1.0)
    os._exit(1)
