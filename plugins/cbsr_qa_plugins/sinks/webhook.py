"""Events as requests to a web server, several in each.

The standard library is enough: one POST at a time, from a thread that may wait.
"""

import io
import json
import re
import socket
import ssl
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from http.client import HTTPConnection, HTTPException, HTTPResponse, HTTPSConnection
from typing import IO, Annotated, Any, Final
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import HTTPHandler, HTTPRedirectHandler, HTTPSHandler, Request, build_opener

from pydantic import AfterValidator, Field

from cbsr_qa.plugin import DeliveryError, PluginOptions, WithOptions
from cbsr_qa_plugins.sinks._options import EnvironmentVariable, Timeout, check_ca_file, secret

#: Refusals that may end: of a token, an address or a rate. Other answers 400 to 499 would be the same again.
_MAY_END: Final = (401, 403, 404, 407, 408, 425, 429)
#: Bytes of an answer that are read [B].
_MAX_ANSWER_BYTES: Final = 65536


def _url(text: str) -> str:
    try:
        parts = urlsplit(text)
        usable = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        usable = False
    if not usable or not re.fullmatch(r"[!-~]+", text):
        raise ValueError("it must be an address like https://example.org/events, in printable ASCII")
    if "@" in parts.netloc or parts.fragment:
        raise ValueError("it must have no user, password or fragment; use token_env for a secret")
    return text


def _header(name: str) -> str:
    if re.fullmatch(r"[A-Za-z0-9-]{1,64}", name):
        return name
    raise ValueError("it must be the name of a header: letters, digits and -")


class _NoRedirect(HTTPRedirectHandler):
    """Refuses redirections: a token goes to no other server than the one that was named."""

    def redirect_request(self, *_: Any) -> None:
        return None


class _AnswerInTime(HTTPResponse):
    """An answer that has to arrive within a time [s]; a limit for each part would never end one that drips."""

    def __init__(self, time_s: float, sock: socket.socket, *args: Any, **options: Any) -> None:
        super().__init__(sock, *args, **options)
        self.fp = io.BufferedReader(_ReadInTime(self.fp.detach(), sock, time.monotonic() + time_s))


class _ReadInTime(io.RawIOBase):
    """Reads from a connection until a time; TimeoutError after it."""

    def __init__(self, raw: io.RawIOBase, sock: socket.socket, ends_s: float) -> None:
        super().__init__()
        self._raw, self._socket, self._ends_s = raw, sock, ends_s

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int | None:
        left_s = self._ends_s - time.monotonic()
        if left_s <= 0:
            raise TimeoutError("timed out")
        self._socket.settimeout(left_s)
        return self._raw.readinto(buffer)

    def close(self) -> None:
        self._raw.close()
        super().close()


def _connecting(kind: type[HTTPConnection], time_s: float) -> Callable[..., HTTPConnection]:
    def connect(host: str, **options: Any) -> HTTPConnection:
        connection = kind(host, **options)
        connection.response_class = partial(_AnswerInTime, time_s)  # type: ignore[assignment]
        return connection

    return connect


class _Http(HTTPHandler):
    def __init__(self, time_s: float) -> None:
        super().__init__()
        self._time_s = time_s

    def http_open(self, request: Request) -> HTTPResponse:
        return self.do_open(_connecting(HTTPConnection, self._time_s), request)


class _Https(HTTPSHandler):
    def __init__(self, time_s: float, context: ssl.SSLContext) -> None:
        super().__init__(context=context)
        self._time_s, self._tls = time_s, context

    def https_open(self, request: Request) -> HTTPResponse:
        connecting = _connecting(HTTPSConnection, self._time_s)
        return self.do_open(connecting, request, context=self._tls)


class Webhook(WithOptions):
    """Posts events to a web server as JSON, `{"events": [...]}`, several in a request.

    Parameters
    ----------
    url : address, http or https. Redirections are not followed. Without https, events and token travel in clear.
    token_env : environment variable that holds a token for the server.
    token_header : header with the token. `Authorization` has `Bearer` before it.
    ca_file : certificates to check the server with, instead of those of the operating system.
    timeout_s : longest wait for a connection, and then for the whole answer; the events are sent again after it.
    largest_batch : most events in a request.
    """

    class Options(PluginOptions):
        url: Annotated[str, AfterValidator(_url)]
        token_env: EnvironmentVariable | None = None
        token_header: Annotated[str, AfterValidator(_header)] = "Authorization"
        ca_file: str | None = None
        timeout_s: Timeout = 5.0
        largest_batch: Annotated[int, Field(ge=1, le=1000)] = 100

    options: Options

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        token = secret("token_env", self.options.token_env)
        check_ca_file(self.options.ca_file)
        self.largest_batch = self.options.largest_batch
        self._headers = {"Content-Type": "application/json", "User-Agent": "cbsr-qa"}
        if token is not None:
            bearer = "Bearer " if self.options.token_header.lower() == "authorization" else ""
            self._headers[self.options.token_header] = f"{bearer}{token}"
        parts = urlsplit(self.options.url)
        self._server = f"{parts.scheme}://{parts.netloc}{parts.path}"  # a query may hold a secret

    def deliver(self, messages: Sequence[Mapping[str, Any]]) -> None:
        body = json.dumps({"events": list(messages)}, separators=(",", ":")).encode()
        request = Request(self.options.url, body, self._headers, method="POST")
        time_s = self.options.timeout_s
        try:
            context = ssl.create_default_context(cafile=self.options.ca_file)
            opener = build_opener(_NoRedirect, _Http(time_s), _Https(time_s, context))
            with opener.open(request, timeout=time_s) as answer:
                _skip(answer)
        except HTTPError as error:
            with error, suppress(OSError, HTTPException):  # its status says enough
                _skip(error)
            final = 400 <= error.code < 500 and error.code not in _MAY_END
            raise DeliveryError(f"{self._server} answers {error.code} {error.reason}", final=final) from error
        except TimeoutError as error:
            raise DeliveryError(f"{self._server} has not answered in full within {time_s:g} s") from error
        except (OSError, HTTPException) as error:
            why = error.reason if isinstance(error, URLError) else error
            raise DeliveryError(f"{self._server} cannot be reached: {why or type(error).__name__}") from error

    def close(self) -> None:
        """Nothing stays open between deliveries."""


def _skip(answer: IO[bytes]) -> None:
    answer.read(_MAX_ANSWER_BYTES)
