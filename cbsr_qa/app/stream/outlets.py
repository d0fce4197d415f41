"""Outlets of the messages of a stream: standard output, TCP, a Unix socket, an MQTT broker.

None of them waits for another, or holds up the frames.
"""

import os
import re
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final, Protocol, Self
from urllib.parse import SplitResult, urlsplit

from cbsr_qa.app.stream.clients import END_S, LARGEST_QUEUE, Server, StandardOutput, Tell
from cbsr_qa.app.stream.messages import AliveMessage, StreamMessage
from cbsr_qa.domain.errors import DeliveryError, RefusedError
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import EventSink
from cbsr_qa.station.event_sinks import Delivery

#: Time without a message after which one says that the stream goes on [s].
_ALIVE_S: Final = 1.0
_ALLOWED: Final = "give -, tcp://HOST:PORT, unix:PATH or mqtt://HOST[:PORT][/TOPIC]"


class Outlet(Protocol):
    """One ``--to``."""

    #: Reason why nothing can be sent there any more; empty while it can.
    over: str

    def send(self, message: StreamMessage) -> None:
        """Queue a message; never waits."""
        ...

    def close(self) -> None:
        """Deliver what is queued, for a limited time."""
        ...


class Outlets:
    """All outlets of a stream; a context manager.

    Raise RefusedError or ConfigError if one is malformed or cannot be used (a port that is taken, no broker).

    Parameters
    ----------
    places : addresses to send to, as of ``cbsr-qa stream --to``.
    write : writes bytes to standard output; None without one.
    tell : called with addresses, and with what happens to clients.
    """

    def __init__(
        self, places: Sequence[str], plugins: Plugins, *, write: Callable[[bytes], None] | None, tell: Tell
    ) -> None:
        self._outlets: list[Outlet] = []
        self._lock, self._over = threading.Lock(), threading.Event()
        self._last: StreamMessage | None = None
        self._sent_s = time.monotonic()
        try:
            for place in places:
                self._outlets.append(_outlet(place, plugins, write, tell))
        except BaseException:
            self.close()
            raise
        self._alive = threading.Thread(target=self._keep_alive, name="stream alive", daemon=True)
        self._alive.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def over(self) -> str:
        """Why no outlet is left that takes messages; empty while one does."""
        whys = [outlet.over for outlet in self._outlets]
        return "; ".join(whys) if all(whys) else ""

    def send(self, message: StreamMessage) -> None:
        """Queue a message for every client; never waits for one."""
        with self._lock:
            self._last, self._sent_s = message, time.monotonic()
            for outlet in self._outlets:
                outlet.send(message)

    def close(self) -> None:
        self._over.set()
        for outlet in self._outlets:
            outlet.close()
        self._outlets = []

    def _keep_alive(self) -> None:
        while not self._over.wait(_ALIVE_S / 4):
            with self._lock:
                last_message, silent_s = self._last, time.monotonic() - self._sent_s
                if last_message is None or silent_s < _ALIVE_S:
                    continue
                self._sent_s = time.monotonic()
                for outlet in self._outlets:
                    outlet.send(AliveMessage("alive", last_message.sequence, last_message.serial))


def _outlet(place: str, plugins: Plugins, write: Callable[[bytes], None] | None, tell: Tell) -> Outlet:
    if place == "-":
        if write is None:
            raise RefusedError("there is no standard output to stream to", remedy=_ALLOWED)
        return StandardOutput(write, tell)
    if place.startswith("unix:") and len(place) > len("unix:"):
        return Server.unix(Path(place.removeprefix("unix:")), tell)
    try:
        url = urlsplit(place)
        port = url.port
    except ValueError as error:
        raise RefusedError(f"--to {place[:200]!r}: {error}", remedy=_ALLOWED) from error
    if url.scheme == "tcp" and url.hostname and port is not None and not url.path.strip("/"):
        return Server.tcp(url.hostname, port, tell)
    if url.scheme in ("mqtt", "mqtts") and url.hostname:
        return _Broker(url, plugins, tell)
    raise RefusedError(f"--to {place[:200]!r} is no place that a stream can go to", remedy=_ALLOWED)


class _Broker:
    """Publishes every message through the sink of events: topic ``TOPIC/SERIAL/TYPE``, the header retained."""

    over = ""

    def __init__(self, url: SplitResult, plugins: Plugins, tell: Tell) -> None:
        tls = url.scheme == "mqtts"
        prefix = url.path.strip("/").replace("{", "{{").replace("}", "}}") or "cbsr-qa/stream"
        if url.password is not None:
            raise RefusedError(
                "--to holds a password, which others could read", remedy="set CBSR_QA_MQTT_PASSWORD in place of it"
            )
        options: dict[str, Any] = {
            "host": url.hostname,
            "topic": f"{prefix}/{{serial}}/{{type}}",
            "qos": 0,
            "tls": tls,
            "retain": ["header"],
        }
        if url.port is not None:
            options["port"] = url.port
        if url.username:
            options |= {"user": url.username}
            if "CBSR_QA_MQTT_PASSWORD" in os.environ:
                options |= {"password_env": "CBSR_QA_MQTT_PASSWORD"}
        sink: EventSink = create_plugin(plugins, Kind.SINK, PluginChoice("mqtt", options), f"--to {url.geturl()}")
        try:
            sink.deliver([])
        except DeliveryError as error:
            raise RefusedError(error.reason, remedy="start the broker, or correct --to") from error
        self._tell = tell
        self._name = f"stream to {url.geturl()}"
        self._delivery = Delivery(self._name, sink, most=LARGEST_QUEUE)
        tell(f"streaming to {url.geturl()}, topic {re.sub(r'{{|}}', '', prefix)}/SERIAL/TYPE")

    def send(self, message: StreamMessage) -> None:
        self._delivery.put(asdict(message))

    def close(self) -> None:
        self._delivery.end()
        self._delivery.wait(END_S)
        loss = self._delivery.describe_loss()
        if loss:
            self._tell(loss)
