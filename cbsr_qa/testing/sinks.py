"""What a run expects of a sink of events."""

import time
from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from typing import Any

from cbsr_qa.domain.run.event_documents import event_document, event_message
from cbsr_qa.domain.run.events import PhaseStarted, RunEvent, RunStarted, StepRetried
from cbsr_qa.plugin.interfaces import EventSink
from cbsr_qa.testing.bench import example_identity
from cbsr_qa.testing.checked import demand

#: How long messages may take to arrive [s].
_ARRIVAL_S = 10.0


def example_messages(count: int) -> list[dict[str, Any]]:
    """Return messages of a run as a sink gets them; one has text that is not ASCII, and a line break."""
    identity = example_identity()
    events: list[RunEvent] = [
        RunStarted(identity),
        PhaseStarted(0, "nine locations", "location-grid", 0.5),
        StepRetried(0, 1, 1, "“Δ”\nfailed"),
    ]
    documents = [event_document(event) for event in events]
    return [event_message(identity, number, documents[number % len(events)]) for number in range(count)]


def check_sink(sink: EventSink, received: Callable[[], Sequence[Mapping[str, Any]]]) -> None:
    """Check that a sink delivers all messages in order, and may be closed twice.

    Parameters
    ----------
    received : returns the messages that have arrived so far, in order.

    Raises
    ------
    AssertionError
        Naming what it did.
    """
    demand(sink, sink.largest_batch >= 1, f"takes {sink.largest_batch} messages in one call")
    messages = example_messages(7)
    waiting = iter(messages)
    while batch := list(islice(waiting, min(3, sink.largest_batch))):
        sink.deliver(batch)
    sink.close()
    sink.close()
    demand(sink, _wait_for_messages(received, messages), f"delivered {list(received())} instead of {messages}")


def _wait_for_messages(
    received: Callable[[], Sequence[Mapping[str, Any]]], messages: Sequence[Mapping[str, Any]]
) -> bool:
    deadline = time.monotonic() + _ARRIVAL_S
    while list(received()) != messages:
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True
