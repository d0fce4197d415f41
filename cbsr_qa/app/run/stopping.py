"""Signals that stop a run: the first one interrupts it, further ones wait for the clean-up."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from cbsr_qa.domain import AbortedError
from cbsr_qa.system import Redelivery, end_later


@contextmanager
def stoppable(*, within_s: float | None = None) -> Iterator[None]:
    """Let the first signal (Ctrl-C, termination, hang-up) interrupt the block; ignore others until it has cleaned up.

    Parameters
    ----------
    within_s : how long that may take, where code of a plugin might catch the interruption; then a process that
        another one watches over is killed. Only if no bench is in use. None: any time.

    Raises
    ------
    AbortedError
        After the clean-up, if a signal or the keyboard interrupted it.
    """
    heard: list[str] = []
    ended: list[Callable[[], None]] = []
    redelivery = Redelivery()

    def stop(number: int, frame: FrameType | None) -> None:
        if not heard or redelivery.was_dropped():
            if not heard and within_s is not None:
                ended.append(end_later(within_s))
            heard.append(signal.Signals(number).name)
            redelivery.number = number
            raise KeyboardInterrupt

    here = threading.current_thread() is threading.main_thread()
    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if here and hasattr(signal, name)]
    numbers = [getattr(signal, name) for name in names]
    # A signal inherited as ignored stays ignored, as the caller intended.
    before = {n: signal.signal(n, stop) for n in numbers if signal.getsignal(n) not in (signal.SIG_IGN, None)}
    try:
        with redelivery:
            yield
    except KeyboardInterrupt as error:
        raise AbortedError(f"signal {heard[0]}" if heard else "the keyboard") from error
    finally:
        for spare in ended:
            spare()
        for number, handler in before.items():
            signal.signal(number, handler)
