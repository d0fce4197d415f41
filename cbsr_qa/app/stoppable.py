"""What must not be cut off half-way is stopped by every signal as by the keyboard."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from cbsr_qa.domain.errors import AbortedError


@contextmanager
def stoppable() -> Iterator[None]:
    """Let the first signal (from the keyboard, termination, hang-up) end what is inside, which then cleans up.

    Further signals are ignored until it has: impatience must not leave a current on.

    Raises
    ------
    AbortedError
        Once what is inside has cleaned up, where a signal or the keyboard stopped it.
    """
    heard: list[str] = []

    def stop(number: int, frame: FrameType | None) -> None:
        if not heard:
            heard.append(signal.Signals(number).name)
            raise KeyboardInterrupt

    here = threading.current_thread() is threading.main_thread()
    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if here and hasattr(signal, name)]
    numbers = [getattr(signal, name) for name in names]
    # One that was inherited as ignored stays so: whoever started the program wanted that.
    before = {n: signal.signal(n, stop) for n in numbers if signal.getsignal(n) not in (signal.SIG_IGN, None)}
    try:
        yield
    except KeyboardInterrupt as error:
        raise AbortedError(f"signal {heard[0]}" if heard else "the keyboard") from error
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
