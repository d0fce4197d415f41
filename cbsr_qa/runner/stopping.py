"""Tell everybody to stop, even when one of them raises or never answers."""

import threading
from collections.abc import Callable, Sequence
from typing import Final

from cbsr_qa.clock import RealClock

#: How long one instrument may take before the next is told as well [s, real time].
PATIENCE_S: Final = 0.25
#: How long all of them together may take [s, real time].
DEADLINE_S: Final = 10.0

Action = tuple[str, Callable[[], object]]


class _Call(threading.Thread):
    """One action in a thread of its own, which is left behind if it never comes back."""

    def __init__(self, name: str, action: Callable[[], object]) -> None:
        super().__init__(name=f"stop {name}", daemon=True)
        self.who = name
        self.done = threading.Event()
        self.why = ""
        self._action = action

    def run(self) -> None:
        """Call, and keep what it raised."""
        try:
            self._action()
        except BaseException as error:  # noqa: BLE001 - nothing one instrument does may stop the others
            self.why = f"{type(error).__name__}: {error}"
        finally:
            self.done.set()


def stop_all(
    actions: Sequence[Action], *, patience_s: float = PATIENCE_S, deadline_s: float = DEADLINE_S
) -> tuple[str, ...]:
    """Call every action; a slow one delays the next by no more than the patience.

    Quick ones are called one after the other, in order, so that a simulated bench does the same each time.
    The waiting is in real time also on a virtual clock: a thread that hangs does so in real time.

    Parameters
    ----------
    actions : (who, what to call).

    Returns
    -------
    In words, who raised or did not come back before the deadline; empty if all did what they were told.
    """
    clock = RealClock()
    calls = [_Call(name, action) for name, action in actions]
    for call in calls:
        try:
            call.start()
        except RuntimeError:  # no more threads to be had: then without one
            call.run()
        call.done.wait(patience_s)
    for call in calls:
        call.done.wait(max(0.0, deadline_s - clock.now()))
    late = [f"{call.who} did not answer within {deadline_s:g} s" for call in calls if not call.done.is_set()]
    return (*(f"{call.who}: {call.why}" for call in calls if call.why), *late)
