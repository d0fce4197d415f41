"""How soon the pages of a line are back after its server was killed: ``python -m benchmarks.line_restarts``.

Two simulated stations run while pages in a real browser and many streams watch them. The server is killed and started
again several times. Counted is from its first answer to a request: what a page can know of it.
"""

import argparse
import os
import random
import signal
import socket
import subprocess
import tempfile
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from statistics import median
from typing import Any, Final
from urllib.parse import urlencode

from cbsr_qa.app.command_hints import build_own_command

_TOKEN: Final = "token-of-this-benchmark"
_SIGNED: Final = {"Authorization": f"Bearer {_TOKEN}"}
_STATIONS: Final = ("line-1", "line-2")
_CHROMIUM: Final = "/usr/bin/chromium"
#: Waits between attempts of a stream, as those of a page, and longest time that a page may take [s].
_RETRY_S: Final = (0.05, 0.15, 0.25, 0.4)
_LIMIT_S: Final = 1.0
#: Notes in a page when it hears from the server again [s since 1970].
_NOTE_BACK: Final = """() => {
    window.back = [];
    new MutationObserver((changes) => {
        if (changes.some((one) => one.oldValue?.includes("lost")) && !document.body.classList.contains("lost"))
            back.push((performance.timeOrigin + performance.now()) / 1000);
    }).observe(document.body, { attributes: true, attributeFilter: ["class"], attributeOldValue: true });
}"""
_SEE_BACK: Final = """() => new Promise((seen) => {
    const look = () => back.length ? seen(back.splice(0)[0]) : setTimeout(look, 20);
    look();
})"""


class Server:
    """``cbsr-qa serve`` at one port, which is killed and started again."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        (folder / "token").write_text(_TOKEN, encoding="ascii")
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port: int = free.getsockname()[1]
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> float:
        """Start the server; return when it gave its first answer [s since 1970]."""
        stations = [f"--station={name}" for name in _STATIONS]
        options = [*stations, "--recipe=nine-locations", f"--port={self.port}", f"--token-file={self._folder}/token"]
        environment = {**os.environ, "CBSR_QA_VAR": str(self._folder / "var")}
        with (self._folder / "serve.log").open("ab") as log:
            program = [*build_own_command("serve"), *options]
            self._process = subprocess.Popen(program, env=environment, stdout=log, stderr=log)
        while True:
            with suppress(OSError, HTTPException):
                self.ask("GET", "/static/icon.svg")
                return time.time()
            time.sleep(0.005)

    def kill(self) -> None:
        assert self._process is not None
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()

    def ask(self, method: str, path: str, **form: str) -> bytes:
        """Send a request that is signed in; return what is answered."""
        connection = HTTPConnection("127.0.0.1", self.port, timeout=20)
        kind = {"Content-Type": "application/x-www-form-urlencoded"} if form else {}
        body = urlencode(form) if form else None
        try:
            connection.request(method, path, body, {**_SIGNED, **kind})
            return connection.getresponse().read()
        finally:
            connection.close()


@dataclass
class Streams:
    """Many streams, each of which connects again as a page does. ``back``: when each heard again [s since 1970]."""

    server: Server
    count: int
    back: list[float] = field(default_factory=list)

    def open(self) -> None:
        for index in range(self.count):
            threading.Thread(target=self._follow, args=(_STATIONS[index % 2],), daemon=True).start()

    def _follow(self, station: str) -> None:
        tries = 0
        while True:
            with suppress(OSError, HTTPException):
                connection = HTTPConnection("127.0.0.1", self.server.port, timeout=20)
                connection.request(
                    "GET", f"/stations/{station}/events", headers={"Authorization": f"Bearer {_TOKEN}"}
                )
                answer = connection.getresponse()
                if answer.status == 200 and answer.readline():
                    self.back.append(time.time())
                    tries = 0
                    while answer.readline():
                        pass
            time.sleep(_RETRY_S[min(tries, len(_RETRY_S) - 1)] * random.uniform(0.75, 1.25))
            tries += 1


def measure(folder: Path, pages: int, streams: int, restarts: int) -> tuple[list[float], list[float]]:
    """Return how long after its first answer the pages, and the streams, heard from the server again [s]."""
    from playwright.sync_api import sync_playwright

    server = Server(folder)
    server.start()
    for name in _STATIONS:
        server.ask("POST", f"/stations/{name}/start", serial=f"S-{name}", recipe="nine-locations")
    watching = Streams(server, streams)
    page_s: list[float] = []
    stream_s: list[float] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=_CHROMIUM, args=["--headless", "--no-sandbox"])
        opened = [_open_page(browser, server, index) for index in range(pages)]
        watching.open()
        time.sleep(5.0)
        for _ in range(restarts):
            server.kill()
            watching.back.clear()
            time.sleep(random.uniform(1.0, 2.0))
            answered_s = server.start()
            for page in opened:
                page_s.append(page.evaluate(_SEE_BACK) - answered_s)
            while len(watching.back) < streams:
                time.sleep(0.01)
            stream_s += [back_s - answered_s for back_s in watching.back]
        browser.close()
    for name in _STATIONS:
        server.ask("POST", f"/stations/{name}/emergency")
    server.kill()
    return page_s, stream_s


def _open_page(browser: Any, server: Server, index: int) -> Any:
    """Open the page of a station in a context of its own: a browser allows six connections to a server for each."""
    page = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
    page.goto(f"http://127.0.0.1:{server.port}/stations/{_STATIONS[index % 2]}?token={_TOKEN}")
    page.evaluate(_NOTE_BACK)
    return page


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--pages", type=int, default=4)
    options.add_argument("--streams", type=int, default=60)
    options.add_argument("--restarts", type=int, default=10)
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        page_s, stream_s = measure(Path(folder), given.pages, given.streams, given.restarts)
    for what, times_s in (("pages in a browser", page_s), ("streams", stream_s)):
        late = "" if max(times_s) <= _LIMIT_S else "  SLOWER than asked"
        print(f"{what:<20} back after {median(times_s):.2f} s in the median, {max(times_s):.2f} s at most{late}")


if __name__ == "__main__":
    main()
