"""Server-sent events of an open page: changes since the last event, never more than one answer behind."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from typing import Any, Final

from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from cbsr_qa.web.line import Line, Viewer
from cbsr_qa.web.pages import Part

#: Time without news after which a page is told that the server is here [s].
_HERE_S: Final = 5.0


async def events(viewer: Viewer, parts: Callable[[], list[Part]], picture: Callable[[], str]) -> AsyncIterator[bytes]:
    """Yield the events of a page until it is closed.

    Parameters
    ----------
    parts : function that returns the page's parts as they are now.
    picture : function that returns the address of the live image; empty without one.
    """
    sent: dict[str, str] = {}
    shown_address = ""
    yield b"retry: 500\n\n"
    while True:
        viewer.news.clear()
        fresh = _fresh(parts(), sent)
        address = picture()
        if fresh or address != shown_address:
            document: dict[str, Any] = {"parts": [[part.place, part.html, part.key] for part in fresh]}
            if address != shown_address:
                document["picture"] = shown_address = address
            yield f"data: {json.dumps(document)}\n\n".encode()
        try:
            async with asyncio.timeout(_HERE_S):
                await viewer.news.wait()
        except TimeoutError:
            yield b"event: here\ndata: \n\n"


def _fresh(parts: list[Part], sent: dict[str, str]) -> list[Part]:
    """Return the parts to send, and note them as sent; after ``body`` all parts inside it follow."""
    sends_all = any(part.place == "body" and sent.get("body") != part.key for part in parts)
    fresh = [part for part in parts if sends_all or sent.get(part.place) != part.key]
    sent.update({part.place: part.key for part in parts})
    return fresh


class EventStream(StreamingResponse):
    """The stream of a page, which counts as a viewer from the start."""

    media_type = "text/event-stream"

    def __init__(
        self, line: Line, viewer: Viewer, parts: Callable[[], list[Part]], picture: Callable[[], str]
    ) -> None:
        super().__init__(events(viewer, parts, picture))
        self._line, self._viewer = line, viewer
        line.viewers.add(viewer)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._line.viewers.discard(self._viewer)
