"""Rights of clients: checks of every request before a page sees it, and headers of every answer.

A browser shows its right by a cookie that a link with the token has set, a program by the token itself
(``Authorization: Bearer``). A cookie counts for a change only from a page of this server (Origin), so that no page of
another site can make a browser start or stop a run.
"""

import asyncio
import hashlib
import hmac
import logging
import re
from collections.abc import Awaitable, Callable, MutableMapping
from dataclasses import dataclass, field
from enum import IntEnum
from http.cookies import CookieError, SimpleCookie
from typing import Any, Final
from urllib.parse import quote

from cbsr_qa.web.guesses import Guesses, TooManyGuessesError, client_network
from cbsr_qa.web.texts import text

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

LOG: Final = logging.getLogger("cbsr_qa.web")

#: Largest body: a form of a page is a tenth of this [B].
MOST_BODY: Final = 16_384
#: Longest path and query [B].
MOST_TARGET: Final = 1_024
#: Longest headers together [B].
MOST_HEADERS: Final = 16_384
#: Longest time for a body [s].
BODY_S: Final = 10.0

#: Marks before a token or a cookie, the form of both, and how many of each are compared.
_MARKS: Final = (b"bearer ", b"token=")
_CREDENTIAL: Final = re.compile(rb" *([\w-]+)")
_MAX_CREDENTIALS: Final = 16

_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self';"
    " form-action 'self'; frame-ancestors 'none'; base-uri 'none'"
)
#: Policy of a page whose drawings bring their own data.
DRAWINGS_POLICY: Final = _POLICY.replace("img-src 'self'", "img-src 'self' data:")
#: Policy of a report, which brings its own style and drawings and runs nothing.
REPORT_POLICY: Final = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; base-uri 'none';"
    " form-action 'none'; sandbox allow-popups"
)
_HEADERS: Final = {
    b"content-security-policy": _POLICY.encode(),
    b"x-content-type-options": b"nosniff",
    b"referrer-policy": b"same-origin",  # with "no-referrer" a browser would not say where a form comes from
    b"cross-origin-opener-policy": b"same-origin",
    b"cross-origin-resource-policy": b"same-origin",
    b"permissions-policy": b"camera=(), geolocation=(), microphone=()",
    b"cache-control": b"no-store",
}


class Right(IntEnum):
    """Right of a request."""

    NONE = 0
    LOOK = 1
    CONTROL = 2


@dataclass(frozen=True, slots=True)
class Access:
    """Names of the server, and the secrets that give rights.

    Parameters
    ----------
    hosts : allowed values of ``Host``, with the port.
    scheme : ``"http"`` or ``"https"``.
    token : secret of at least 16 characters; a client that shows it may control.
    anyone_may_look : whether pages are shown without the token.
    port : port of the server; part of the cookie's name, as the ports of a computer share cookies.
    cookie_key : secret; without it, a guess of the token gives no cookie to try.
    emergencies : paths of emergency stops.
    guesses : wrong tokens by client.
    """

    hosts: frozenset[str]
    scheme: str
    token: str
    anyone_may_look: bool
    port: int
    cookie_key: str = field(repr=False)
    emergencies: frozenset[str]
    guesses: Guesses = field(default_factory=Guesses, repr=False)

    @property
    def cookie(self) -> str:
        return f"cbsr_qa_{self.port}"

    @property
    def cookie_value(self) -> str:
        """A digest, so that a reader of the cookie does not learn the token."""
        return hmac.new(self.cookie_key.encode(), f"cbsr-qa cookie {self.token}".encode(), hashlib.sha256).hexdigest()

    def set_cookie(self) -> str:
        secure = "; Secure" if self.scheme == "https" else ""
        return f"{self.cookie}={self.cookie_value}; HttpOnly; SameSite=Strict; Path=/; Max-Age=31536000{secure}"

    def check_token(self, given: str, client: str) -> bool:
        """Return whether this is the token. TooManyGuessesError if the client gave too many wrong ones to be told."""
        self.guesses.admit(client, given)
        right = self.is_token(given)
        if right:
            self.guesses.accept(client)
        return right

    def is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self.token.encode())

    def is_shown_in(self, data: bytes) -> bool:
        """Whether the beginning of a request shows the token or its cookie, so that it is read first.

        This gives no right: :class:`Guard` decides on the right of the request.
        """
        right_values = (self.token.encode(), self.cookie_value.encode())
        lower = data.lower()
        for mark in (*_MARKS, f"{self.cookie}=".encode()):  # sooner than by one expression
            end = 0
            for _ in range(_MAX_CREDENTIALS):
                begin = lower.find(mark, end)
                if begin < 0:
                    break
                end = begin + len(mark)
                credential = _CREDENTIAL.match(data, end)
                if credential and any(
                    hmac.compare_digest(credential[1], right_value) for right_value in right_values
                ):
                    return True
        return False


@dataclass(frozen=True, slots=True)
class RefusedRequestError(Exception):
    """A request that is not answered."""

    status: int
    words: str
    headers: tuple[tuple[bytes, bytes], ...] = ()


class Guard:
    """The outermost application: refuses bad requests, and passes the others on with their right."""

    def __init__(self, inner: App, access: Access) -> None:
        self._inner, self._access = inner, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] != "http":
            await self._inner(scope, receive, send)
            return
        try:
            scope["cbsr_right"] = self._check_request(scope)
            body = await _body(receive) if scope["method"] not in ("GET", "HEAD") else b""
        except RefusedRequestError as refusal:
            LOG.warning("refused %s %s: %s", scope["method"], quote(scope["path"])[:120], refusal.words)
            await _answer(refusal, send)
            return
        await self._inner(scope, _replay_body(body, receive), _with_headers(send))

    def _check_request(self, scope: Scope) -> Right:
        headers = _headers(scope)
        if headers.get(b"host", b"").decode("latin-1").lower() not in self._access.hosts:
            raise RefusedRequestError(421, text("refused.host"))
        if len(scope.get("raw_path") or b"") + len(scope["query_string"]) > MOST_TARGET:
            raise RefusedRequestError(414, text("refused.target"))
        if sum(len(name) + len(value) for name, value in scope["headers"]) > MOST_HEADERS:
            raise RefusedRequestError(431, text("refused.headers"))
        if scope["method"] not in ("GET", "HEAD", "POST"):
            raise RefusedRequestError(405, text("refused.method"))
        right, by_cookie = self._right(scope, headers)
        if scope["method"] == "POST":
            self._check_change(scope, headers, right, by_cookie)
        return right

    def _right(self, scope: Scope, headers: dict[bytes, bytes]) -> tuple[Right, bool]:
        """Return the right of a request, and whether a cookie gives it."""
        kind, _, token = headers.get(b"authorization", b"").decode("latin-1").partition(" ")
        if kind.lower() == "bearer":
            self._check_bearer(scope, token.strip())
            return Right.CONTROL, False
        try:
            cookies = SimpleCookie(headers.get(b"cookie", b"").decode("latin-1"))
        except CookieError:
            cookies = SimpleCookie()
        cookie = cookies.get(self._access.cookie)
        if cookie is not None and hmac.compare_digest(cookie.value.encode(), self._access.cookie_value.encode()):
            return Right.CONTROL, True
        return (Right.LOOK if self._access.anyone_may_look else Right.NONE), True

    def _check_bearer(self, scope: Scope, token: str) -> None:
        is_emergency = scope["method"] == "POST" and scope["path"] in self._access.emergencies
        if is_emergency and self._access.is_token(token):
            return  # an emergency stop waits for nobody's guesses; a right guess stops the station
        try:
            if self._access.check_token(token, client_of(scope)):
                return
        except TooManyGuessesError as wait:
            retry = ((b"retry-after", str(wait.wait_s).encode()),)
            raise RefusedRequestError(429, text("refused.guesses", seconds=wait.wait_s), retry) from None
        raise RefusedRequestError(401, text("refused.token"))

    def _check_change(self, scope: Scope, headers: dict[bytes, bytes], right: Right, by_cookie: bool) -> None:
        if by_cookie:
            host = headers[b"host"].decode("latin-1").lower()
            origin = headers.get(b"origin", b"").decode("latin-1").lower()
            if origin != f"{self._access.scheme}://{host}":
                raise RefusedRequestError(403, text("refused.origin"))
        if right < Right.CONTROL and scope["path"] != "/sign-in":
            raise RefusedRequestError(401, text("refused.control"))
        if not headers.get(b"content-type", b"").startswith(b"application/x-www-form-urlencoded"):
            raise RefusedRequestError(415, text("refused.form"))
        length = headers.get(b"content-length", b"0")
        if not length.isdigit() or int(length) > MOST_BODY:
            raise RefusedRequestError(413, text("refused.body"))


def client_of(scope: Scope) -> str:
    """Return the client of a request, for counting its guesses."""
    client = scope.get("client")
    return client_network(client[0]) if client else ""


def _headers(scope: Scope) -> dict[bytes, bytes]:
    """Return the headers; the value is empty if a header is repeated that must not be."""
    value_by_name: dict[bytes, bytes] = {}
    for name, value in scope["headers"]:
        value_by_name[name] = (
            b"" if name in value_by_name and name in (b"host", b"origin", b"authorization") else value
        )
    return value_by_name


async def _body(receive: Receive) -> bytes:
    body = bytearray()
    try:
        async with asyncio.timeout(BODY_S):
            while True:
                message = await receive()
                body += message.get("body", b"")
                if len(body) > MOST_BODY:
                    raise RefusedRequestError(413, text("refused.body"))
                if message["type"] == "http.disconnect" or not message.get("more_body", False):
                    return bytes(body)
    except TimeoutError:
        raise RefusedRequestError(408, text("refused.slow")) from None


def _replay_body(body: bytes, receive: Receive) -> Receive:
    waiting = [body]

    async def replay() -> MutableMapping[str, Any]:
        if waiting:
            return {"type": "http.request", "body": waiting.pop(), "more_body": False}
        return await receive()

    return replay


def _with_headers(send: Send) -> Send:
    async def send_with_headers(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            own_names = {name.lower() for name, _ in message["headers"]}
            message["headers"] = [
                *message["headers"],
                *(header for header in _HEADERS.items() if header[0] not in own_names),
            ]
        await send(message)

    return send_with_headers


async def _answer(refusal: RefusedRequestError, send: Send) -> None:
    body = f"{refusal.words}\n".encode()
    headers = [
        (b"content-type", b"text/plain; charset=utf-8"),
        (b"content-length", str(len(body)).encode()),
        (b"connection", b"close"),
        *refusal.headers,
    ]
    await _with_headers(send)({"type": "http.response.start", "status": refusal.status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
