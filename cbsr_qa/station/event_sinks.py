"""Delivery of a run's events to sinks, each with its own thread and bounded queue; none delays or stops a run."""

import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

from cbsr_qa.domain.errors import CbsrError, DeliveryError
from cbsr_qa.domain.plan.plan import EventSinkSpec
from cbsr_qa.domain.run.event_documents import event_document, event_message
from cbsr_qa.domain.run.events import RunConcluded, RunEvent
from cbsr_qa.domain.run.run import RunIdentity
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import EventSink
from cbsr_qa.station.documents import Warn
from cbsr_qa.system.copies import end_forked_copies
from cbsr_qa.system.words import describe_error

#: Most events that wait for a sink; beyond it the oldest are lost.
#: The recipe nine-locations has 2920 on the simulated bench.
LARGEST_QUEUE: Final = 10_000
#: Time for delivering what is pending at the end of a run, for all sinks together [s].
END_S: Final = 5.0
#: Pauses between attempts [s]: doubled after each failure, up to the longest.
_FIRST_PAUSE_S: Final = 0.5
_LONGEST_PAUSE_S: Final = 30.0

Message = Mapping[str, Any]


class EventSinks:
    """A subscriber that passes the events of a run to sinks.

    Parameters
    ----------
    identity : identity of the run.
    warn : function called with sinks that cannot be used, and at the end with the number of lost events.
    first : number of the first event.

    Attributes
    ----------
    number : number of the next event.
    """

    def __init__(
        self, specs: Sequence[EventSinkSpec], plugins: Plugins, identity: RunIdentity, warn: Warn, *, first: int = 0
    ) -> None:
        self._identity = identity
        self._warn = warn
        self.number = first
        self._deliveries: list[Delivery] = []
        for spec in specs:
            try:
                sink = create_plugin(plugins, Kind.SINK, spec.sink, f"events {spec.name!r}")
            except CbsrError as error:
                warn(f"no events are delivered: {error.reason}")
            else:
                self._deliveries.append(Delivery(f"events {spec.name!r} ({spec.sink.name})", sink))

    def __call__(self, event: RunEvent | RunConcluded) -> None:
        if not self._deliveries:
            return
        message = event_message(self._identity, self.number, event_document(event))
        self.number += 1
        for delivery in self._deliveries:
            delivery.put(message)

    def end(self) -> None:
        """Wait up to :data:`END_S` for pending events, then warn of those that were lost."""
        for delivery in self._deliveries:
            delivery.end()
        deadline = time.monotonic() + END_S
        for delivery in self._deliveries:
            delivery.wait(deadline - time.monotonic())
        for lost in filter(None, [delivery.describe_loss() for delivery in self._deliveries]):
            self._warn(lost)


class Delivery:
    """One sink, its queue and its thread.

    Parameters
    ----------
    name : name of the sink in warnings.
    most : number of events that may wait.
    """

    def __init__(self, name: str, sink: EventSink, *, most: int = LARGEST_QUEUE) -> None:
        self._name = name
        self._sink = sink
        self._most = most
        self._changed = threading.Condition()
        self._waiting: deque[Message] = deque()
        self._sending: list[Message] = []
        self._total = self._dropped = 0
        self._why = ""
        self._ending = self._given_up = False
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def put(self, message: Message) -> None:
        """Queue a message; never waits for the sink."""
        with self._changed:
            if len(self._waiting) >= self._most:
                self._waiting.popleft()
                self._dropped += 1
            self._waiting.append(message)
            self._total += 1
            self._changed.notify()

    def end(self) -> None:
        """Let the thread end once everything is delivered."""
        with self._changed:
            self._ending = True
            self._changed.notify()

    def wait(self, longest_s: float) -> None:
        """Wait for the thread to end; after this time it delivers nothing more."""
        self._thread.join(max(longest_s, 0.0))
        with self._changed:
            self._given_up = True
            self._changed.notify()

    def describe_loss(self) -> str:
        """Return how many events were not delivered, and why; empty if all were."""
        with self._changed:
            lost = self._dropped + len(self._sending) + len(self._waiting)
            reason = self._why or "the sink did not take them in time"
            return f"{self._name}: {lost} of {self._total} events were not delivered: {reason}" if lost else ""

    def _work(self) -> None:
        pause_s = _FIRST_PAUSE_S
        while batch := self._wait_for_batch():
            if self._deliver(batch):
                pause_s = _FIRST_PAUSE_S
            else:
                self._pause(pause_s)
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
        with suppress(BaseException), end_forked_copies():  # a plugin's code may raise anything
            self._sink.close()

    def _wait_for_batch(self) -> list[Message]:
        """Return the messages to send, those that failed first; none at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._sending or self._waiting or self._ending)
            if self._given_up:
                return []
            if not self._sending:
                size = min(len(self._waiting), max(self._sink.largest_batch, 1))
                self._sending = [self._waiting.popleft() for _ in range(size)]
            return self._sending

    def _deliver(self, batch: list[Message]) -> bool:
        """Deliver a batch, and keep the reason of a failure; False if the batch is to be sent again."""
        reason, dropped = "", 0
        try:
            with end_forked_copies():
                self._sink.deliver(batch)
        except BaseException as error:  # noqa: BLE001 - a plugin's code may raise anything
            reason = describe_error(error)
            if not (isinstance(error, DeliveryError) and error.final):
                with self._changed:
                    self._why = reason
                return False
            dropped = len(batch)
        with self._changed:
            self._why = reason or self._why
            if not self._given_up:  # otherwise it is counted as lost already
                self._sending = []
                self._dropped += dropped
        return True

    def _pause(self, pause_s: float) -> None:
        """Wait before the next attempt; the end of the run shortens it."""
        with self._changed:
            self._changed.wait_for(lambda: self._ending, pause_s)
            if self._ending:
                self._changed.wait_for(lambda: self._given_up, _FIRST_PAUSE_S)
