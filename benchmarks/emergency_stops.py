"""Emergency stops at the page of a line while clients without the token keep its server busy: how long each takes.

``python -m benchmarks.emergency_stops``

No run is in progress: the time is that of the page, without the run's own. The clients run in another process. Each
of their connections sends a whole request, reads the answer, sends the next request letter by letter, and opens again
as soon as it is closed. With ``--much`` it sends 250 kB at once and opens again after a second without an answer: the
beginning of a head (``head``), many requests (``requests``), or requests with many short headers (``headers``). With
``--look`` the page is shown to anyone, and each asks for the given paths in turn. With ``--stalled`` they begin a
handshake of TLS instead and go no further; with ``--hello`` their hello is whole, so that the server works on each.
"""

import argparse
import asyncio
import http.client
import os
import re
import resource
import ssl
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from itertools import cycle
from pathlib import Path
from typing import Any, Final

from benchmarks.rows import Row
from cbsr_qa.app.command_hints import build_own_command

_STATION: Final = Path(__file__).parents[1] / "stations" / "line-1.toml"
_CERTIFY: Final = (
    "openssl req -x509 -newkey rsa:2048 -nodes -keyout line.key -out line.pem -days 2 -subj /CN=localhost"
    " -addext subjectAltName=DNS:localhost,IP:127.0.0.1"
)
#: Between letters of a client, and before it opens a connection again that was refused [s].
_DRIP_S: Final = 0.5
_AGAIN_S: Final = 0.05
_GOAL_S: Final = 1.0
#: What a client sends at once, and how long it waits for an answer.
_MUCH: Final = 250_000
_PATIENCE_S: Final = 1.0
_HELLO: Final = bytes.fromhex("16030102000100")  # the beginning of a handshake of TLS


class Line:
    """``cbsr-qa serve`` of one simulated station.

    Parameters
    ----------
    files : most files that it may have open; None as here.
    options : of ``serve``, besides.
    """

    def __init__(self, folder: Path, *, tls: bool, files: int | None, options: Sequence[str] = ()) -> None:
        (folder / "line-1.toml").write_text(_STATION.read_text(encoding="utf-8"), encoding="utf-8")
        arguments = ["serve", "--station=line-1.toml", "--port=0", *options]
        if tls:
            subprocess.run(_CERTIFY.split(), cwd=folder, check=True, capture_output=True)
            arguments += ["--certificate=line.pem", "--key=line.key"]
        self._log = folder / "serve.log"
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                build_own_command(*arguments),
                cwd=folder,
                env={**os.environ, "CBSR_QA_VAR": str(folder / "var")},
                stdout=log,
                stderr=log,
            )
        if files is not None:  # before it has begun to serve
            resource.prlimit(self._process.pid, resource.RLIMIT_NOFILE, (files, files))
        self.port, token = self._address()
        self._headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/x-www-form-urlencoded"}
        self._context = ssl._create_unverified_context() if tls else None  # it made the certificate itself

    def _address(self) -> tuple[int, str]:
        for _ in range(1200):
            found = re.search(r"://127.0.0.1:(\d+)/\?token=(\S+)", self._log.read_text(encoding="utf-8"))
            if found:
                return int(found[1]), found[2]
            time.sleep(0.1)
        raise SystemExit(self._log.read_text(encoding="utf-8"))

    def stop_s(self) -> float | None:
        """Ask for an emergency stop; return how long the answer took [s], None if there was none."""
        began_s = time.monotonic()
        connection = (
            http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
            if self._context is None
            else http.client.HTTPSConnection("127.0.0.1", self.port, timeout=30, context=self._context)
        )
        try:
            connection.request("POST", "/stations/line-1/emergency", "", self._headers)
            answer = connection.getresponse()
            said = answer.read()
            if answer.status == 200 and b"words" in said:
                return time.monotonic() - began_s
            print(f"answered {answer.status}: {said[:100]!r}", file=sys.stderr)
        except (OSError, http.client.HTTPException) as error:
            print(f"not answered: {error!r}", file=sys.stderr)
        finally:
            connection.close()
        return None

    def close(self) -> None:
        self._process.terminate()
        self._process.wait(30)


async def _drip(port: int) -> None:
    """Keep one connection of a client open."""
    while True:
        with suppress(OSError):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            try:
                writer.write(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
                await reader.readuntil(b"</html>")
                while True:
                    writer.write(b"G")
                    await writer.drain()
                    with suppress(TimeoutError):
                        async with asyncio.timeout(_DRIP_S):
                            if not await reader.read(4096):
                                break
            except (asyncio.IncompleteReadError, asyncio.LimitOverrunError):
                pass
            finally:
                writer.close()
        await asyncio.sleep(0)


def _requests(port: int, much: str) -> bytes:
    """Return what a client sends at once."""
    request = f"GET /static/line.css HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n"
    if much == "head":
        return f"{request}A: {'b' * _MUCH}".encode()
    if much == "headers":
        request += "a:b\r\n" * 3_000
    return f"{request}\r\n".encode() * max(1, _MUCH // len(request))


async def _send_much(port: int, sent: bytes, context: ssl.SSLContext | None) -> None:
    """Send much on one connection, read what is answered, and open it again after a second without an answer."""
    while True:
        with suppress(OSError):
            reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context)
            writer.write(sent)
            with suppress(OSError, TimeoutError):
                while await asyncio.wait_for(reader.read(2**16), _PATIENCE_S):
                    pass
            writer.close()
        await asyncio.sleep(0)


async def _look(port: int, paths: Sequence[str]) -> None:
    """Ask for pages, one after another, each on a connection of its own."""
    for path in cycle(paths):
        with suppress(OSError):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n\r\n".encode())
            with suppress(OSError):
                while await reader.read(2**16):
                    pass
            writer.close()
        await asyncio.sleep(_AGAIN_S)


def _whole_hello() -> bytes:
    sent = ssl.MemoryBIO()
    with suppress(ssl.SSLWantReadError):
        ssl._create_unverified_context().wrap_bio(ssl.MemoryBIO(), sent).do_handshake()
    return sent.read()


async def _stall(port: int, hello: bytes) -> None:
    """Keep one handshake of TLS begun."""
    while True:
        with suppress(OSError):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(hello)
            with suppress(OSError):
                while await reader.read(4096):
                    pass
            writer.close()
        await asyncio.sleep(_AGAIN_S)


async def _attack(chosen: argparse.Namespace) -> None:
    port, hello = chosen.attack, _whole_hello() if chosen.hello else _HELLO
    if chosen.stalled:
        await asyncio.gather(*(_stall(port, hello) for _ in range(chosen.stalled)))
    count = range(chosen.connections)
    if chosen.much:
        sent, context = _requests(port, chosen.much), ssl._create_unverified_context() if chosen.tls else None
        await asyncio.gather(*(_send_much(port, sent, context) for _ in count))
    if chosen.look:
        await asyncio.gather(*(_look(port, [*chosen.look[n % len(chosen.look) :], *chosen.look]) for n in count))
    await asyncio.gather(*(_drip(port) for _ in count))


@contextmanager
def _process(arguments: Sequence[str]) -> Iterator[None]:
    process = subprocess.Popen([sys.executable, *arguments])
    try:
        yield
    finally:
        process.kill()
        process.wait()


def _measure(chosen: argparse.Namespace) -> list[float | None]:
    with tempfile.TemporaryDirectory() as folder, ExitStack() as open_:
        options = [f"--database={chosen.database}"] if chosen.database else []
        options += ["--anyone-may-look"] if chosen.look else []
        line = Line(Path(folder), tls=chosen.tls or bool(chosen.stalled), files=chosen.files, options=options)
        open_.callback(line.close)
        for _ in range(chosen.busy):
            open_.enter_context(_process(["-c", "while True: pass"]))
        how = [f"--stalled={chosen.stalled}", f"--connections={chosen.connections}", *["--hello"] * chosen.hello]
        how += [f"--much={chosen.much}"] * bool(chosen.much) + ["--look", *chosen.look] * bool(chosen.look)
        how += ["--tls"] * chosen.tls
        open_.enter_context(_process(["-m", "benchmarks.emergency_stops", f"--attack={line.port}", *how]))
        time.sleep(chosen.settle)
        taken: list[float | None] = []
        for _ in range(chosen.stops):
            taken.append(line.stop_s())
            time.sleep(chosen.between)
        return taken


def _doing(chosen: argparse.Namespace) -> str:
    if chosen.much:
        return f"that send 250 kB ({chosen.much}){' by TLS' * chosen.tls}"
    return f"that ask for {' and '.join(chosen.look)}" if chosen.look else "that drip"


def row(chosen: argparse.Namespace, taken: Sequence[float | None]) -> Row:
    """Return what was measured against what was asked."""
    answered = sorted(one for one in taken if one is not None)
    failures = len(taken) - len(answered)
    clients = (
        f"{chosen.stalled} handshakes of TLS stalled {'after' if chosen.hello else 'within'} their hello,"
        f" {chosen.files or 'any number of'} files"
        if chosen.stalled
        else f"{chosen.connections} connections {_doing(chosen)}"
    )
    times = (
        f"median {statistics.median(answered):.2f} s, maximum {answered[-1]:.2f} s" if answered else "none answered"
    )
    late = sum(one > _GOAL_S for one in answered)
    return Row(
        f"{len(taken)} emergency stops, {clients}, {chosen.busy} busy loops on {os.cpu_count()} cores",
        f"≤ {_GOAL_S:g} s",
        f"{times}, {late} later, {failures} failed",
        met=not (late or failures),
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Attack a line, and print a row."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.emergency_stops", description=__doc__)
    parser.add_argument("--connections", type=int, default=400, help="of clients without the token, that drip")
    parser.add_argument("--much", choices=("head", "requests", "headers"), help="that they send instead")
    parser.add_argument("--look", nargs="+", default=[], metavar="PATH", help="pages that they ask for instead")
    parser.add_argument("--database", help="whose runs are shown then")
    parser.add_argument("--tls", action="store_true", help="with --stalled always; clients with --much as well")
    parser.add_argument("--stalled", type=int, default=0, help="handshakes of TLS instead of them")
    parser.add_argument("--hello", action="store_true", help="of stalled handshakes is whole")
    parser.add_argument("--files", type=int, help="most files that the server may have open")
    parser.add_argument("--busy", type=int, default=0, help="processes that compute without end")
    parser.add_argument("--stops", type=int, default=60)
    parser.add_argument("--between", type=float, default=0.5, help="stops [s]")
    parser.add_argument("--settle", type=float, default=8.0, help="before the first one [s]")
    parser.add_argument("--attack", type=int, help=argparse.SUPPRESS)
    chosen: Any = parser.parse_args(arguments)
    if chosen.attack:
        asyncio.run(_attack(chosen))
    else:
        print(row(chosen, _measure(chosen)).markdown())


if __name__ == "__main__":
    main()
