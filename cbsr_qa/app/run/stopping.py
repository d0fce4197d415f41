"""Signals that stop what is before or after a run: the first interrupts it, further ones wait for the clean-up."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Final

from cbsr_qa.domain.errors import AbortedError, StoppedError
from cbsr_qa.system.redelivery import Redelivery
from cbsr_qa.system.stubborn import end_later

#: Time that it may take to give up opening a bench, to make it safe and to close it [s].
_CLOSES_WITHIN_S: Final = 45.0


@contextmanager
def stoppable_outside_steps() -> Iterator[None]:
    """Let a signal end the block before a run's first step, or after its last, so that what is open is closed.

    During the steps the run hears signals itself; see :class:`cbsr_qa.station.interrupts.Interrupts`.

    Raises
    ------
    StoppedError
        After the clean-up, if a signal or the keyboard interrupted it.
    """
    try:
        with stoppable(within_s=_CLOSES_WITHIN_S):
            yield
    except AbortedError as error:
        raise StoppedError(
            f"stopped by {error.by} outside of the steps of a run; the bench is closed",
            remedy="start it again; cbsr-qa db status lists a run that had begun",
        ) from error


@contextmanager
def stoppable(*, within_s: float | None = None) -> Iterator[None]:
    """Let the first signal (Ctrl-C, termination, hang-up) interrupt the block; ignore others until it has cleaned up.

    Parameters
    ----------
    within_s : longest clean-up [s], where code of a plugin might catch the interruption; then a process that
        another one watches over is killed. Only if no head is down. None: any time.

    Raises
    ------
    AbortedError
        After the clean-up, if a signal or the keyboard interrupted it.
    """
    signal_names: list[str] = []
    cancel_callbacks: list[Callable[[], None]] = []
    redelivery = Redelivery()

    def stop(number: int, frame: FrameType | None) -> None:
        if signal.getsignal(number) is not stop:  # the steps of a run hear it meanwhile, and ask who sent it
            if callable(handler_by_signal[number]):
                handler_by_signal[number](number, frame)
            return
        if not signal_names or redelivery.was_dropped():
            if not signal_names and within_s is not None:
                cancel_callbacks.append(end_later(within_s))
            signal_names.append(signal.Signals(number).name)
            redelivery.number = number
            raise KeyboardInterrupt(f"signal {signal_names[0]}")

    in_main_thread = threading.current_thread() is threading.main_thread()
    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if in_main_thread and hasattr(signal, name)]
    numbers = [getattr(signal, name) for name in names]
    # A signal inherited as ignored stays ignored, as the caller intended.
    caught_numbers = [number for number in numbers if signal.getsignal(number) not in (signal.SIG_IGN, None)]
    handler_by_signal: dict[int, Any] = {number: signal.signal(number, stop) for number in caught_numbers}
    try:
        with redelivery:
            yield
    except KeyboardInterrupt as error:
        raise AbortedError(f"signal {signal_names[0]}" if signal_names else "the keyboard") from error
    finally:
        for cancel in cancel_callbacks:
            cancel()
        for number, handler in handler_by_signal.items():
            signal.signal(number, handler)
