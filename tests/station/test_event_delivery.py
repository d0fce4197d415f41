"""Delivery to sinks: what they do, however badly, neither delays a run nor goes unsaid."""

import threading
from types import SimpleNamespace

import pytest
from stored_runs import identity, short_run

from cbsr_qa.domain.errors import DeliveryError
from cbsr_qa.domain.plan.plan import EventSinkSpec, PluginChoice
from cbsr_qa.domain.run.event_documents import event_document, event_message
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.hooks import Kind, hookimpl
from cbsr_qa.station import event_sinks
from cbsr_qa.station.event_sinks import Delivery, EventSinks

EVENTS = short_run("run-1")


class Sink:
    """Takes messages, after failing as it is told to."""

    largest_batch = 3

    def __init__(self, *failures, hold=None):
        self.failures, self.hold, self.taken, self.closed = list(failures), hold, [], False

    def deliver(self, messages):
        if self.hold is not None:
            self.hold.wait()
        if self.failures:
            raise self.failures.pop(0)
        self.taken += messages

    def close(self):
        self.closed = True


@pytest.fixture(autouse=True)
def _at_once(monkeypatch):
    monkeypatch.setattr(event_sinks, "_FIRST_PAUSE_S", 0.001)


def delivered(sink, *, count=10, wait_s=10.0, most=100):
    delivery = Delivery("events 'plant'", sink, most=most)
    for number in range(count):
        delivery.put({"number": number})
    delivery.end()
    delivery.wait(wait_s)
    return delivery.describe_loss()


def numbers(sink):
    return [message["number"] for message in sink.taken]


def test_everything_arrives_in_order_and_the_sink_is_closed():
    assert delivered(sink := Sink()) == ""
    assert numbers(sink) == list(range(10))
    assert sink.closed


@pytest.mark.parametrize("failure", [DeliveryError("away"), OSError("away"), SystemExit("away")])
def test_after_a_failure_the_same_messages_are_sent_again(failure):
    assert delivered(sink := Sink(failure, failure)) == ""
    assert numbers(sink) == list(range(10))


def test_what_is_refused_for_good_is_counted_and_the_rest_follows():
    hold = threading.Event()
    sink = Sink(DeliveryError("it is too large", final=True), hold=hold)
    delivery = Delivery("events 'plant'", sink)
    for number in range(10):
        delivery.put({"number": number})
    hold.set()
    delivery.end()
    delivery.wait(10.0)
    lost = 10 - len(sink.taken)
    assert 1 <= lost <= 3
    assert numbers(sink) == list(range(lost, 10))
    assert delivery.describe_loss() == f"events 'plant': {lost} of 10 events were not delivered: it is too large"


def test_a_sink_that_never_works_costs_the_stated_time_and_its_last_failure_is_said():
    lost = delivered(Sink(*[DeliveryError("nobody answers")] * 100_000), wait_s=0.05)
    assert lost == "events 'plant': 10 of 10 events were not delivered: nobody answers"


def test_a_sink_that_hangs_holds_nobody_up():
    hold = threading.Event()
    sink = Sink(hold=hold)
    lost = delivered(sink, wait_s=0.05)
    assert lost == "events 'plant': 10 of 10 events were not delivered: the sink did not take them in time"
    hold.set()


def test_a_full_queue_loses_the_oldest():
    hold = threading.Event()
    sink = Sink(hold=hold)
    delivery = Delivery("events 'plant'", sink, most=5)
    for number in range(1000):
        delivery.put({"number": number})
    hold.set()
    delivery.end()
    delivery.wait(10.0)
    assert numbers(sink)[-5:] == list(range(995, 1000))
    assert delivery.describe_loss().startswith(f"events 'plant': {1000 - len(sink.taken)} of 1000 ")


def plugins_with(**sinks):
    """Plugins that have these sinks; each is made by a function of this module's namespace."""
    plugins = Plugins()

    @hookimpl
    def cbsr_register(register):
        for name in sinks:
            register(Kind.SINK, name, f"{__name__}:_made_{name}")

    globals().update({f"_made_{name}": make for name, make in sinks.items()})
    plugins.add(SimpleNamespace(cbsr_register=cbsr_register), "lab", "1", "lab")
    return plugins


def test_the_events_of_a_run_reach_every_sink_although_one_cannot_be_made():
    def broken():
        raise RuntimeError("no")

    first, second, warnings = Sink(), Sink(), []
    plugins = plugins_with(first=lambda: first, second=lambda: second, broken=broken)
    specs = [EventSinkSpec(f"to_{name}", PluginChoice(name)) for name in ("first", "broken", "second")]
    sinks = EventSinks(specs, plugins, identity("run-1"), warnings.append)
    for event in EVENTS:
        sinks(event)
    sinks.end()
    whole = [event_message(identity("run-1"), number, event_document(event)) for number, event in enumerate(EVENTS)]
    assert first.taken == second.taken == whole
    (warning,) = warnings
    assert "events 'to_broken': sink 'broken' failed: RuntimeError: no" in warning
