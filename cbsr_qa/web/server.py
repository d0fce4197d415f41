"""``cbsr-qa serve``: checks, then a server that runs until it is stopped. It stops no run."""

import asyncio
import logging
import resource
import secrets
import signal
import socket
import ssl
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import Final

import uvicorn

from cbsr_qa.config.paths import var_folder, writable_folder
from cbsr_qa.domain.errors import ConfigError, RefusedError
from cbsr_qa.system.foreign import read_foreign
from cbsr_qa.web.application import make_application
from cbsr_qa.web.connections import connection_settings
from cbsr_qa.web.guard import LOG, Access
from cbsr_qa.web.handshakes import ListeningSocket, ServerLoop
from cbsr_qa.web.line import Line
from cbsr_qa.web.stations import load_stations

#: Shortest token that somebody may choose.
_MIN_TOKEN_LENGTH: Final = 16
_ALLOWED: Final = f"allowed: a file with at least {_MIN_TOKEN_LENGTH} letters, digits, - and _"
_MAX_TOKEN_FILE_BYTES: Final = 2**12
_MAX_PEM_BYTES: Final = 2**20
_PEM: Final = "both must be PEM files, of the same pair, readable and without a passphrase"
#: Number of files that may be open: twice that of connections.
_MAX_FILES: Final = 4096


@dataclass(frozen=True, slots=True)
class ServeRequest:
    """Stations to serve, and address of the page; see the options of ``cbsr-qa serve``."""

    stations: Sequence[str]
    recipes: Sequence[str] = ()
    host: str = "127.0.0.1"
    port: int = 8765
    names: Sequence[str] = ()
    certificate: Path | None = None
    key: Path | None = None
    token_file: Path | None = None
    anyone_may_look: bool = False
    database: str | None = None


def serve(request: ServeRequest, tell: Callable[[str], None]) -> None:
    """Serve the page until a signal ends it.

    Parameters
    ----------
    tell : function called with the address of the page once it can be opened.

    Raises
    ------
    RefusedError
        Before anything is served: a file, an address or a certificate is wrong, or the port is taken.
    """
    _log_to_stderr()
    _raise_file_limit()
    served = load_stations(request.stations, request.recipes)
    loopback = _is_loopback(request.host)
    tls = _certificate(request, loopback=loopback)
    token = _token(request)
    listening = _listening(request.host, request.port)
    port = listening.getsockname()[1]
    scheme = "http" if tls is None else "https"
    emergencies = frozenset(f"/stations/{station.name}/emergency" for station in served)
    access = Access(_hosts(request, port), scheme, token, request.anyone_may_look, port, _cookie_key(), emergencies)
    line = Line(served, request.database)
    config = uvicorn.Config(
        make_application(line, access),
        loop="asyncio",
        log_config=None,
        access_log=False,
        server_header=False,
        lifespan="on",
        timeout_graceful_shutdown=1,
        ssl_certfile=None if tls is None else tls[0],
        ssl_keyfile=None if tls is None else tls[1],
        **connection_settings(access.is_shown_in),
    )
    shown_host = request.names[0] if request.names else "127.0.0.1" if loopback else request.host
    shown_host = f"[{shown_host}]" if ":" in shown_host else shown_host
    tell(f"{scheme}://{shown_host}:{port}/?token={token}")
    with asyncio.Runner(loop_factory=ServerLoop) as runner:
        runner.run(_Server(config).serve(sockets=[listening]))


class _Server(uvicorn.Server):
    """Server that ends in order on a signal, which is its normal end."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        ending_signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        previous_handlers = {number: signal.signal(number, self.handle_exit) for number in ending_signals}
        try:
            yield
        finally:
            for number, handler in previous_handlers.items():
                signal.signal(number, handler)


def _raise_file_limit() -> None:
    """Let all connections be open at once beside the files of the program, as far as the system allows."""
    soft_limit, hard_limit = resource.getrlimit(resource.RLIMIT_NOFILE)
    limit = _MAX_FILES if hard_limit == resource.RLIM_INFINITY else min(_MAX_FILES, hard_limit)
    if soft_limit != resource.RLIM_INFINITY and soft_limit < limit:
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard_limit))


def _log_to_stderr() -> None:
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    for logger, level in ((LOG, logging.INFO), (logging.getLogger("uvicorn.error"), logging.WARNING)):
        logger.handlers, logger.propagate = [handler], False
        logger.setLevel(level)


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def _hosts(request: ServeRequest, port: int) -> frozenset[str]:
    """Return the allowed values of ``Host``."""
    loopback_names = ("127.0.0.1", "localhost", "[::1]") if _is_loopback(request.host) else ()
    host = f"[{request.host}]" if ":" in request.host else request.host
    names = {*loopback_names, host, *request.names}
    with_port = {f"{name.lower()}:{port}" for name in names}
    return frozenset(with_port | ({name.lower() for name in names} if port in (80, 443) else set()))


def _certificate(request: ServeRequest, *, loopback: bool) -> tuple[Path, Path] | None:
    """Return the files of certificate and key. ConfigError if they are missing, unreadable, or not a pair."""
    if request.certificate is None and request.key is None:
        if loopback:
            return None
        raise ConfigError(
            f"--host {request.host} is reached from other computers: without TLS the token could be intercepted",
            remedy="give --certificate and --key (PEM files), or leave --host out to serve this computer alone",
        )
    if request.certificate is None or request.key is None:
        raise ConfigError("--certificate and --key belong together", remedy="give both")
    for file, kind in ((request.certificate, "certificate"), (request.key, "key")):
        try:
            read_foreign(file, _MAX_PEM_BYTES)
        except OSError as error:
            raise ConfigError(f"{kind} {file} cannot be read: {_why(error)}", remedy=_PEM) from error
    try:
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        context.load_cert_chain(request.certificate, request.key, password=lambda: "")  # OpenSSL would ask for it
    except (OSError, ValueError) as error:  # errors of TLS are OSError too
        raise ConfigError(
            f"certificate {request.certificate} and key {request.key} cannot be used: {_why(error)}", remedy=_PEM
        ) from error
    return request.certificate, request.key


def _why(error: Exception) -> str:
    """Return the problem of a file in words, without its name and without error numbers."""
    if isinstance(error, UnicodeError):
        return "it holds other characters than ASCII"
    reason = getattr(error, "reason", None)  # OpenSSL states it in capitals
    if isinstance(reason, str):
        return reason.replace("_", " ").lower()
    if isinstance(error, ssl.SSLError):
        return "one of them is not in PEM, is damaged, or has a passphrase"
    return getattr(error, "strerror", None) or str(error)


def _token(request: ServeRequest) -> str:
    """Return the token: of the given file, or one that is made once and kept."""
    file = request.token_file or _make_secret("serve.token")
    token = _read_secret(file, "the token")
    if len(token) < _MIN_TOKEN_LENGTH or not all(character.isalnum() or character in "-_" for character in token):
        raise ConfigError(f"the token in {file} cannot be used", remedy=_ALLOWED)
    return token


def _cookie_key() -> str:
    """Return the secret of cookies besides the token. It is kept: a browser stays signed in over a restart."""
    file = _make_secret("serve.cookie-key")
    key = _read_secret(file, "the key of cookies")
    if len(key) < _MIN_TOKEN_LENGTH:
        raise ConfigError(f"the key of cookies in {file} is too short", remedy="delete the file: a new key is made")
    return key


def _make_secret(name: str) -> Path:
    """Return the file of a secret that only this user may read; it is made if it is missing."""
    file = writable_folder(var_folder() / "control") / name
    if not file.exists():
        file.touch(mode=0o600)
        file.write_text(secrets.token_urlsafe(24), encoding="ascii")
    return file


def _read_secret(file: Path, what: str) -> str:
    try:
        return read_foreign(file, _MAX_TOKEN_FILE_BYTES).decode("ascii").strip()
    except (OSError, UnicodeError) as error:
        raise ConfigError(f"{what} cannot be read from {file}: {_why(error)}", remedy=_ALLOWED) from error


def _listening(host: str, port: int) -> socket.socket:
    """Return a socket that listens. RefusedError if the address is not this computer's, or the port is taken."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = ListeningSocket(family, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
        listening.listen()  # clients that open the address at once wait for the server
    except (OSError, OverflowError) as error:
        listening.close()
        reason = getattr(error, "strerror", None) or str(error)
        raise RefusedError(
            f"{host}, port {port}: {reason}",
            remedy="is the page served already? Open it, end the other program, or choose another --port",
        ) from error
    return listening
