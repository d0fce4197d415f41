"""Signals that stop a run: the first one interrupts it, further ones wait for the clean-up."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from cbsr_qa.domain import AbortedError
from cbsr_qa.system import Redelivery


@contextmanager
def stoppable() -> Iterator[None]:
    """Let the first signal (Ctrl-C, termination, hang-up) interrupt the block; ignore others until it has cleaned up.

    Raises
    ------
    AbortedError
        After the clean-up, if a signal or the keyboard interrupted it.
    """
    heard: list[str] = []
    redelivery = Redelivery()

    def stop(number: int, frame: FrameType | None) -> None:
        if not heard or redelivery.was_dropped():
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
        for number, handler in before.items():
            signal.signal(number, handler)
