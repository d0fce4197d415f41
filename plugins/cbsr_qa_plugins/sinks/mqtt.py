"""Events as messages of an MQTT broker."""

import json
import queue
import socket
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Annotated, Any, ClassVar, Final, Literal

from pydantic import AfterValidator, Field

from cbsr_qa.plugin import Array, ConfigError, DeliveryError, PluginOptions, Problem, WholeNumber, WithOptions
from cbsr_qa_plugins.sinks._options import (
    EnvironmentVariable,
    Timeout,
    check_ca_file,
    check_template,
    fill_template,
    secret,
)

#: A connection without traffic is checked at this interval [s].
_KEEP_ALIVE_S: Final = 30
#: How long the broker may take to be told of the end [s].
_GOODBYE_S: Final = 1.0
_PORT, _TLS_PORT = 1883, 8883


def _topic(text: str) -> str:
    check_template(text, "type")
    if set("+#") & set(text) or text.startswith("$") or len(text.encode()) > 1000:
        raise ValueError("it must be a topic of at most 1000 bytes without + and #, and must not start with $")
    return text


class Mqtt(WithOptions):
    """Publishes each event as one JSON message to an MQTT broker (extra `mqtt`).

    Parameters
    ----------
    host : name or address of the broker.
    port : of the broker; 1883 by default, with TLS 8883.
    topic : may have the fields {station}, {serial}, {run} and {type}, the type of the event.
    retain : types of events of which the broker keeps the last one, for those who subscribe later.
    qos : 0 at most once, 1 at least once, 2 exactly once; with 1 and 2 the broker confirms each message.
    tls : encrypts, and checks the broker's certificate. Without TLS, events and password travel in clear.
    ca_file : certificates to check it with, instead of those of the operating system.
    user : name to log in with.
    password_env : environment variable that holds the password.
    timeout_s : longest wait for a connection, and for the confirmation of up to 100 messages.
    """

    class Options(PluginOptions):
        host: Annotated[str, Field(min_length=1, max_length=253, pattern=r"^[A-Za-z0-9._:-]+$")]
        port: Annotated[int, Field(ge=1, le=65535)] | None = None
        topic: Annotated[str, AfterValidator(_topic)] = "cbsr-qa/{station}/{type}"
        retain: Annotated[tuple[str, ...], Array] = ()
        qos: Annotated[Literal[0, 1, 2], WholeNumber] = 1
        tls: bool = False
        ca_file: str | None = None
        user: Annotated[str, Field(min_length=1, max_length=256)] | None = None
        password_env: EnvironmentVariable | None = None
        timeout_s: Timeout = 5.0

        def problems(self) -> Iterator[Problem]:
            if self.ca_file is not None and not self.tls:
                yield Problem(("ca_file",), "is given, but tls is not true")
            if self.password_env is not None and self.user is None:
                yield Problem(("password_env",), "is given without a user")

    options: Options
    largest_batch: ClassVar[int] = 100

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        try:
            self._paho = import_module("paho.mqtt.client")
        except ImportError as error:
            remedy = 'install it: pip install "cbsr-qa[mqtt]"'
            raise ConfigError("the library paho-mqtt is missing", remedy=remedy) from error
        self._password = secret("password_env", self.options.password_env)
        check_ca_file(self.options.ca_file)
        self._port = self.options.port or (_TLS_PORT if self.options.tls else _PORT)
        self._broker = f"broker {self.options.host}:{self._port}"
        self._client: Any = None
        self._disconnected = threading.Event()

    def deliver(self, messages: Sequence[Mapping[str, Any]]) -> None:
        if self._client is None or not self._client.is_connected():
            self._drop_connection()
            self._connect()
        try:
            self._publish(self._client, messages)
        except (OSError, ValueError, RuntimeError) as error:  # paho raises the latter two when the connection is lost
            self._drop_connection()
            raise DeliveryError(f"{self._broker}: {error}") from error
        except DeliveryError:
            self._drop_connection()
            raise

    def close(self) -> None:
        if self._client is not None and self._client.is_connected():
            with suppress(OSError, ValueError):
                self._client.disconnect()
            self._disconnected.wait(_GOODBYE_S)
        self._drop_connection()

    def _drop_connection(self) -> None:
        """Forget the connection, whatever is still to be sent: paho's thread would wait for the broker to take it."""
        if self._client is not None:
            client, self._client = self._client, None
            connection = client.socket()
            if connection is not None:
                with suppress(OSError, ValueError):
                    connection.shutdown(socket.SHUT_RDWR)
            client.loop_stop()

    def _publish(self, client: Any, messages: Sequence[Mapping[str, Any]]) -> None:
        deadline = time.monotonic() + self.options.timeout_s
        sent = [
            client.publish(
                fill_template(self.options.topic, message),
                json.dumps(message, separators=(",", ":")),
                self.options.qos,
                retain=message.get("event", message)["type"] in self.options.retain,
            )
            for message in messages
        ]
        for publication in sent:
            publication.wait_for_publish(max(deadline - time.monotonic(), 0.001))
            if not publication.is_published():
                raise DeliveryError(f"{self._broker} has not confirmed within {self.options.timeout_s:g} s")

    def _connect(self) -> None:
        """Connect and log in. DeliveryError if the broker is not there, does not answer or refuses."""
        options, answers = self.options, queue.SimpleQueue[Any]()
        self._client = client = self._paho.Client(self._paho.CallbackAPIVersion.VERSION2, reconnect_on_failure=False)
        client.connect_timeout = options.timeout_s
        self._disconnected.clear()
        client.on_disconnect = lambda *_: self._disconnected.set()
        client.on_connect = lambda client, data, flags, reason, properties: answers.put(reason)
        if options.user is not None:
            client.username_pw_set(options.user, self._password)
        try:
            if options.tls:
                client.tls_set(ca_certs=options.ca_file)
            client.connect(options.host, self._port, keepalive=_KEEP_ALIVE_S)
            client.loop_start()
            reason = answers.get(timeout=options.timeout_s)
        except queue.Empty:
            self._drop_connection()
            raise DeliveryError(f"{self._broker} does not answer within {options.timeout_s:g} s") from None
        except (OSError, ValueError) as error:
            self._drop_connection()
            raise DeliveryError(f"{self._broker} cannot be reached: {error}") from error
        if reason.is_failure:
            self._drop_connection()
            raise DeliveryError(f"{self._broker} refuses the connection: {reason}")
