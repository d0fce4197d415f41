"""The page's end of the control channel of a run: it keeps the run's state and passes on requests of viewers."""

import asyncio
import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from itertools import count
from typing import Any, Final

from cbsr_qa.station.control.lock import control_socket
from cbsr_qa.station.control.server import LONGEST_LINE
from cbsr_qa.system.json_text import parse_json
from cbsr_qa.web.guard import LOG
from cbsr_qa.web.state import Control, control_of
from cbsr_qa.web.texts import text

#: Interval between attempts to connect [s].
_RETRY_S: Final = 0.2
#: Longest wait for an answer [s].
_ANSWER_S: Final = 5.0
#: Force above which a page that joins a run takes the head to be down, until it hears of a step [N].
_TOUCHES_N: Final = 0.2


class ChannelClient:
    """Follows the runs of one station, one after the other. Used by one event loop.

    Parameters
    ----------
    changed : function called when ``control`` has changed.
    """

    def __init__(self, station: str, changed: Callable[[], None]) -> None:
        self._station, self._changed = station, changed
        self._writer: asyncio.StreamWriter | None = None
        self._replies: dict[int, asyncio.Future[Mapping[str, Any]]] = {}
        self._numbers = count(1)
        self._hello: Mapping[str, Any] = {}
        self._down = False
        self.control: Control | None = None
        self.prompt_picture = ""

    async def follow(self) -> None:
        """Connect whenever a run offers its channel, until cancelled."""
        while True:
            with suppress(OSError, ValueError):  # no run, one that ends, or a line that is too long
                reader, self._writer = await asyncio.open_unix_connection(
                    control_socket(self._station), limit=LONGEST_LINE
                )
                await self._read(reader)
            self._close()
            await asyncio.sleep(_RETRY_S)

    async def ask(self, do: str, **what: Any) -> str:
        """Send a request to the run; return its reason to refuse, empty if it obeys."""
        if self._writer is None:
            return text("control.no_run")
        number = next(self._numbers)
        reply = self._replies[number] = asyncio.get_running_loop().create_future()
        try:
            self._writer.write(json.dumps({"id": number, "do": do, **what}).encode() + b"\n")
            async with asyncio.timeout(_ANSWER_S):
                await self._writer.drain()
                answer = await reply
        except (OSError, TimeoutError, asyncio.CancelledError) as error:
            if isinstance(error, asyncio.CancelledError) and not reply.cancelled():
                raise
            return text("control.no_answer")
        finally:
            self._replies.pop(number, None)
        return "" if answer.get("ok") is True else str(answer.get("why") or text("control.no_answer"))

    async def _read(self, reader: asyncio.StreamReader) -> None:
        while line := await reader.readline():
            try:
                document = parse_json(line)
                self._take(document)
            except (AttributeError, KeyError, TypeError, ValueError) as error:
                LOG.warning("%s: the run's channel sent something else: %r", self._station, error)

    def _take(self, document: Mapping[str, Any]) -> None:
        match document.get("type"):
            case "hello":
                force_N = document["state"].get("force_N")
                self._hello, self._down = document, force_N is not None and abs(force_N) > _TOUCHES_N
                self._state(document["state"])
            case "state":
                self._state(document)
            case "step_started":
                self._down = document["step"]["kind"] == "press" or (
                    self._down and document["step"]["kind"] != "release"
                )
            case "reply":
                number = document["id"]
                reply = self._replies.get(number) if type(number) is int else None
                if reply is not None and not reply.done():
                    reply.set_result(document)

    def _state(self, state: Mapping[str, Any]) -> None:
        self.control = control_of(self._hello, state, down=self._down)
        prompt = state.get("prompt") or {}
        self.prompt_picture = str(prompt.get("picture") or "")
        self._changed()

    def _close(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None
        for reply in self._replies.values():
            reply.cancel()
        if self.control is not None:
            self.control = None
            self._changed()
