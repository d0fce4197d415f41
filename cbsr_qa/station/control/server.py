"""The channel of a run: a Unix socket that sends its events as JSON lines and takes requests.

It has its own thread and event loop. A client that does not read, or sends what it should not, is disconnected; the
run never waits for one.
"""

import asyncio
import json
import os
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.run.event_documents import event_document
from cbsr_qa.domain.run.events import PhaseStarted, RunEvent, StepStarted
from cbsr_qa.station.control.desk import ControlDesk
from cbsr_qa.station.control.lock import control_socket, private_folder
from cbsr_qa.station.control.messages import (
    Activity,
    ChannelLine,
    Hello,
    Refused,
    Reply,
    SensorUnderTest,
    State,
)
from cbsr_qa.system.json_text import parse_json

#: Version of the lines, raised when a key is removed or changes its meaning.
PROTOCOL: Final = 1
#: Longest line that is sent [bytes]; a reader needs room for it.
LONGEST_LINE: Final = 1 << 20
#: Longest request [bytes].
_LONGEST_REQUEST: Final = 16 << 10
#: Longest name and longest answer that are taken [characters].
_LONGEST_NAME, _LONGEST_ANSWER = 64, 4000
_REQUESTS: Final = ("pause", "continue", "stop", "emergency", "answer", "state")
#: Of what a request holds, that is repeated.
_LONGEST_QUOTE: Final = 60
#: A client with more than this unread is disconnected [bytes]; it can connect again, and is told everything.
_MOST_UNREAD: Final = 2 * LONGEST_LINE
#: Connections at a time; more are refused.
_MOST_CLIENTS: Final = 32
#: Time between two requests of a client, so that a flood of them costs the run nothing [s].
_BETWEEN_S: Final = 0.02
#: How long a client may take to read what is left when the run ends [s].
_LAST_WORDS_S: Final = 0.5
#: How long the thread may take to start or to end [s].
_PATIENCE_S: Final = 2.0


class RunServer:
    """Serves the channel while entered. It is also a subscriber of the run's events.

    A socket that cannot be made is no reason not to test: ``why`` then says why there is no channel.

    Parameters
    ----------
    station : its lock is held by this process, so that a socket that is found there belongs to nobody.
    sensor : returns which sensor is tested, for the first line of each connection.
    activity : returns what the run does.
    """

    def __init__(
        self,
        station: str,
        desk: ControlDesk,
        sensor: Callable[[], SensorUnderTest],
        activity: Callable[[], Activity],
    ) -> None:
        self.why = ""
        self._station, self._desk, self._sensor, self._activity = station, desk, sensor, activity
        self._clients: set[asyncio.StreamWriter] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._path: Path | None = None
        self._started, self._over = threading.Event(), asyncio.Event()
        self._thread = threading.Thread(target=self._serve, name="control channel", daemon=True)

    def __enter__(self) -> Self:
        try:
            self._listening = self._bind()
        except (OSError, AttributeError) as error:  # AttributeError: no such sockets on this system
            self.why = f"no control channel: {getattr(error, 'strerror', None) or error}"
            return self
        self._thread.start()
        if not self._started.wait(_PATIENCE_S):
            self.why = "no control channel: its thread did not start"
        self._desk.changed = self.state_changed
        return self

    def __exit__(self, *_: object) -> None:
        self._desk.changed = lambda: None
        if self._path is None:
            return
        self._later(self._over.set)
        self._thread.join(_PATIENCE_S)
        self._loop = None
        with suppress(OSError):
            self._path.unlink()

    def __call__(self, event: RunEvent) -> None:
        """Send an event; returns at once."""
        if self._clients:
            self._later(self._send_all, _line(event_document(event)))
            if isinstance(event, StepStarted | PhaseStarted):
                self.state_changed()

    def state_changed(self) -> None:
        """Send the state, without the list of planned loads; returns at once."""
        if self._clients:
            self._later(self._send_state)

    def _send_state(self) -> None:
        """Send the state as it is now: in the loop's thread, so that states arrive in order."""
        self._send_all(_line(replace(self._state(), loads=None)))

    def _state(self) -> State:
        return State.from_parts(self._activity(), self._desk.state())

    def _bind(self) -> socket.socket:
        path = control_socket(self._station)
        private_folder(path.parent)
        with suppress(FileNotFoundError):
            path.unlink()  # of a run that was killed
        listening = socket.socket(socket.AF_UNIX)
        try:
            listening.bind(str(path))
            path.chmod(0o600)  # nobody can connect before it listens
            listening.listen(_MOST_CLIENTS)
        except BaseException:
            listening.close()
            raise
        self._path = path
        return listening

    def _later(self, call: Callable[..., object], *arguments: Any) -> None:
        loop = self._loop
        if loop is not None:
            with suppress(RuntimeError):  # it has ended
                loop.call_soon_threadsafe(call, *arguments)

    def _serve(self) -> None:
        with suppress(Exception):  # the channel may end, the run goes on
            asyncio.run(self._serve_until_over())

    async def _serve_until_over(self) -> None:
        self._loop = asyncio.get_running_loop()
        server = await asyncio.start_unix_server(self._client, sock=self._listening, limit=_LONGEST_REQUEST)
        self._started.set()
        await self._over.wait()
        server.close()
        for writer in tuple(self._clients):
            await self._last_words(writer)

    @staticmethod
    async def _last_words(writer: asyncio.StreamWriter) -> None:
        """Send what is left, to a client that reads; then close the connection for forked helpers too."""
        with suppress(OSError, TimeoutError):
            await asyncio.wait_for(writer.drain(), _LAST_WORDS_S)
            if writer.can_write_eof():
                writer.write_eof()

    async def _client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._clients) >= _MOST_CLIENTS:
            self._send(writer, _line(Refused("refused", f"{_MOST_CLIENTS} are connected already")))
            writer.close()
            return
        self._clients.add(writer)  # first: what happens from here on is sent after the state
        hello = fill_from_object(Hello, self._sensor(), protocol=PROTOCOL, pid=os.getpid(), state=self._state())
        self._send(writer, _line(hello))
        try:
            while line := await reader.readline():
                self._send(writer, _line(self._reply(line)))
                await asyncio.sleep(_BETWEEN_S)
        except (OSError, ValueError, asyncio.CancelledError):  # a line longer than allowed; the run has ended
            pass
        finally:
            self._clients.discard(writer)
            writer.close()

    def _send_all(self, line: bytes) -> None:
        for writer in tuple(self._clients):
            self._send(writer, line)

    def _send(self, writer: asyncio.StreamWriter, line: bytes) -> None:
        if writer.transport.get_write_buffer_size() > _MOST_UNREAD:
            self._clients.discard(writer)
            writer.transport.abort()
        elif not writer.is_closing():
            writer.write(line)

    def _reply(self, line: bytes) -> Reply:
        number = None
        try:
            content = _content(line)
            number = _number(content)
            request = _Request.from_content(content)
            if request.do == "state":
                return Reply("reply", number, ok=True, state=self._state())
            request.put_to(self._desk)
        except RefusedError as error:
            return Reply("reply", number, ok=False, why=error.reason)
        return Reply("reply", number, ok=True)


@dataclass(frozen=True, slots=True)
class _Request:
    do: str
    by: str
    prompt: int
    text: str

    @classmethod
    def from_content(cls, content: dict[str, Any]) -> Self:
        do, by = content.get("do"), content.get("by", "")
        prompt, text = content.get("prompt", -1), content.get("text", "")
        if do not in _REQUESTS:
            raise RefusedError(f"unknown request: 'do' is {_quote_json(do)}; allowed are {', '.join(_REQUESTS)}")
        if not (isinstance(by, str) and len(by) <= _LONGEST_NAME and by.isprintable()):
            raise RefusedError(
                f"'by' is {_quote_json(by)}; it must be a name of at most {_LONGEST_NAME} printable characters"
            )
        if type(prompt) is not int:
            raise RefusedError(f"'prompt' is {_quote_json(prompt)}; it must be the number of the open prompt")
        if not (isinstance(text, str) and len(text) <= _LONGEST_ANSWER and "\0" not in text):
            raise RefusedError(
                f"'text' is {_quote_json(text)}; it must be text of at most {_LONGEST_ANSWER} characters, without NUL"
            )
        return cls(do, by.strip(), prompt, text)

    def put_to(self, desk: ControlDesk) -> None:
        by = self.by or "somebody"
        match self.do:
            case "pause":
                desk.pause(by)
            case "continue":
                desk.resume(by)
            case "stop":
                desk.stop(by)
            case "emergency":
                desk.emergency(by)
            case "answer":
                desk.answer(self.prompt, self.text, by)


def _number(content: dict[str, Any]) -> int | str | None:
    number = content.get("id")
    if number is not None and type(number) not in (int, str):
        raise RefusedError(f"'id' is {_quote_json(number)}; allowed: a whole number or a text")
    return number


def _quote_json(value: object) -> str:
    """Return a value as JSON writes it, cut where it is long."""
    shown = json.dumps(value)
    return shown if len(shown) <= _LONGEST_QUOTE else f"{shown[:_LONGEST_QUOTE]}…"


def _content(line: bytes) -> dict[str, Any]:
    try:
        content = parse_json(line)
    except ValueError as error:
        raise RefusedError(f"the line is not JSON: {error}") from None
    if not isinstance(content, dict):
        raise RefusedError("the line is not a JSON object")
    return content


def _line(what: ChannelLine | dict[str, Any]) -> bytes:
    document = what if isinstance(what, dict) else asdict(what)
    return json.dumps(document, ensure_ascii=True, allow_nan=False).encode() + b"\n"
