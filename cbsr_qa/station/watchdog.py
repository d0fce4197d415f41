"""Watchdog: detects instrument calls that hang, so the head does not stay down."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, Self

from cbsr_qa.domain.errors import CbsrError, SafetyError
from cbsr_qa.plugin.failures import Interruption, blame_plugin
from cbsr_qa.system.clock import RealClock

#: Time a call gets beyond that of its work once the run is to stop in order [s, real time].
GRACE_S: Final = 10.0
#: Longest time for the run's own thread to react before the bench is made safe without it [s, real time].
REACTION_S: Final = 0.5
#: Interval between looks of the watchdog [s, real time].
LOOK_S: Final = 0.1


class BrokenInto(Interruption):
    """Raised in the run's thread, inside the call that hangs."""

    def __init__(self, error: SafetyError) -> None:
        super().__init__(error.reason)
        self.error = error


@dataclass(slots=True)
class _Call:
    """The current call: instrument, start, and expected duration."""

    what: str
    since_s: float
    work_s: float


class Watchdog:
    """A thread that ends calls that take too long. It uses real time on every clock, as real calls hang.

    It watches from its entry to :meth:`end`: each call to an instrument, and the run's other work in between, such as
    a journal that waits for its disk, or a listener for a terminal that has been stopped.

    Parameters
    ----------
    answer_s : longest time of a call beyond twice the time of its work [s].
    break_in : function that raises an error in the run's thread, wherever that hangs.
    make_safe : function called if that does not help.
    tell : function called with a message in that case.
    excused : function that says whether an operator is being asked.
    """

    def __init__(
        self,
        answer_s: float,
        *,
        break_in: Callable[[BaseException], None],
        make_safe: Callable[[], object],
        tell: Callable[[str], None],
        excused: Callable[[], bool] = lambda: False,
    ) -> None:
        self._answer_s = answer_s
        self._break_in = break_in
        self._make_safe = make_safe
        self._tell = tell
        self._excused = excused
        self._clock = RealClock()
        # One assignment each, so that a signal's handler and two threads need no lock.
        self._call = self._describe_idle()
        self._late: SafetyError | None = None
        self._insisted = False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)

    def __enter__(self) -> Self:
        self._call = self._describe_idle()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> None:
        """Stop watching: no further call is interrupted."""
        self._ended.set()
        self._thread.join()

    def hurry(self) -> None:
        """Shorten the time for the current call and all that follow; safe to call from a signal handler."""
        self._answer_s = min(self._answer_s, GRACE_S)
        self._call.since_s = self._clock.now()

    def insist(self) -> None:
        """Make the bench safe without the run's thread if that does not do it at once; called from any thread."""
        self._insisted = True

    @contextmanager
    def expect(self, what: str, work_s: float = 0.0) -> Iterator[None]:
        """Watch over a call.

        SafetyError with rule ``"no answer"`` if it was broken into or came back too late, and for every call after
        that; PluginError for any other error of the call. ``work_s``: normal duration of the call [s].
        """
        self._raise_late()
        self._call = _Call(what, self._clock.now(), work_s)
        try:
            with blame_plugin(what):
                yield
        except BrokenInto as broken:
            raise broken.error from None
        except CbsrError:  # a driver has translated the error
            self._raise_late()
            raise
        finally:
            self._call = self._describe_idle()
        self._raise_late()

    def _describe_idle(self) -> _Call:
        return _Call("the journal or an event listener", self._clock.now(), 0.0)

    def _raise_late(self) -> None:
        if self._late is not None:
            raise self._late

    def _watch(self) -> None:
        while not self._ended.wait(LOOK_S):
            call = self._call
            if self._insisted:
                if not self._ended.wait(REACTION_S):
                    self._make_safe_without(f"{call.what} does not return")
                return
            if self._excused():
                call.since_s = self._clock.now()
            elif self._clock.now() - call.since_s > 2 * call.work_s + self._answer_s:
                self._end(call)
                return

    def _end(self, call: _Call) -> None:
        took_s = self._clock.now() - call.since_s
        late = self._late = SafetyError(
            "no answer",
            f"{call.what} has not returned for {took_s:.3g} s",
            remedy="check what hangs, and its cable",
        )
        self._break_in(BrokenInto(late))
        if not self._ended.wait(REACTION_S) and self._call is call:
            self._make_safe_without(late.reason)

    def _make_safe_without(self, why: str) -> None:
        self._tell(f"{why}; the bench is made safe without it")
        self._make_safe()
