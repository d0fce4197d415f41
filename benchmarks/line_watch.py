"""The page of a line while it is watched: from frame to screen, lateness of runs, processor, memory, write-ahead log.

``python -m benchmarks.line_watch``

Simulated stations run one sensor after the other. For a while nobody watches, then viewers do: one in a real browser,
the others as streams that take every picture. A frame is late by how much longer ago it should have been stored, by
the station's clock, than the frame of its run that was soonest.
"""

import argparse
import os
import re
import signal
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http.client import HTTPConnection
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlencode

import numpy as np

from benchmarks.rows import Row
from cbsr_qa.app.command_hints import build_own_command

_STATIONS: Final = Path(__file__).parents[1] / "stations"
_CHROMIUM: Final = Path("/usr/bin/chromium")
_ARGUMENTS: Final = ["--headless", "--no-sandbox", "--disable-gpu"]
#: Between looks at the store [s]: a frame is taken to be stored as soon as the look before it was seen.
_LOOK_S: Final = 0.004
#: Notes in the page when each picture has been painted [ms since 1970].
_NOTE_PICTURES: Final = """
window.painted = [];
new MutationObserver((changes) => {
  const address = changes.map((one) => one.target.getAttribute("href")).pop();
  requestAnimationFrame(() => setTimeout(() => painted.push([address, performance.timeOrigin + performance.now()])));
}).observe(document.getElementById("body"), { subtree: true, attributes: true, attributeFilter: ["href"] });
"""


@dataclass
class Seen:
    """What was seen of a stretch of time.

    Parameters
    ----------
    stored : per run (number of its latest frame, station time [s], time of storing [s since 1970]) of each block.
    painted : (run, frame, time [s since 1970]) of each picture.
    memory_MB, log_MB : of the page's process, and of the write-ahead log, in time.
    """

    stored: dict[str, list[tuple[int, float, float]]] = field(default_factory=dict)
    painted: list[tuple[str, int, float]] = field(default_factory=list)
    memory_MB: list[float] = field(default_factory=list)
    log_MB: list[float] = field(default_factory=list)
    page_share: float = 0.0

    def latencies_s(self) -> np.ndarray[Any, Any]:
        """From the store to the screen, of each block that was stored between the first and the last picture [s]."""
        found = []
        for run, blocks in self.stored.items():
            pictures = sorted((when, frame) for of, frame, when in self.painted if of == run)
            for number, _, stored_s in blocks:
                if pictures and pictures[0][0] <= stored_s:
                    found += [when - stored_s for when, frame in pictures if frame >= number][:1]
        return np.array(found)

    def lateness_s(self, speed: float) -> np.ndarray[Any, Any]:
        """Of each block against the soonest one of its run [s]."""
        found: list[float] = []
        for blocks in self.stored.values():
            behind = np.array([stored_s - station_s / speed for _, station_s, stored_s in blocks])
            found += (behind - behind.min()).tolist()
        return np.array(found)


class Line:
    """``cbsr-qa serve`` of some simulated stations, each of which tests one sensor after the other."""

    def __init__(self, folder: Path, stations: int, speed: float, recipe: str, kind: str) -> None:
        self.names = [f"bench-{index + 1}" for index in range(stations)]
        text = re.sub(r"clock_speed = .*\n", "", (_STATIONS / f"{kind}.toml").read_text(encoding="utf-8"))
        text = text.replace('clock = "virtual"', f'clock = "virtual"\nclock_speed = {speed}')
        for name in self.names:
            (folder / f"{name}.toml").write_text(text.replace(f'"{kind}"', f'"{name}"'), encoding="utf-8")
        self._environment = {**os.environ, "CBSR_QA_VAR": str(folder / "var")}
        self._log = (folder / "serve.log").open("wb")
        program = [*build_own_command("serve"), f"--recipe={recipe}", "--port=0"]
        self.process = subprocess.Popen(
            [*program, *(f"--station={name}.toml" for name in self.names)],
            cwd=folder,
            env=self._environment,
            stdout=self._log,
            stderr=self._log,
        )
        self.database = folder / "var" / "cbsr-qa.db"
        self.port, self.token = self._address(folder / "serve.log")
        self._tested = 0

    def _address(self, log: Path) -> tuple[int, str]:
        for _ in range(600):
            found = re.search(r"http://127.0.0.1:(\d+)/\?token=(\S+)", log.read_text(encoding="utf-8"))
            if found:
                return int(found[1]), found[2]
            time.sleep(0.1)
        raise SystemExit(log.read_text(encoding="utf-8"))

    def request(self, method: str, path: str, fields: dict[str, str] | None = None) -> tuple[int, bytes]:
        connection = HTTPConnection("127.0.0.1", self.port, timeout=60)
        connection.request(method, path, urlencode(fields or {}), self.headers())
        answer = connection.getresponse()
        return answer.status, answer.read()

    def headers(self) -> dict[str, str]:
        kind = "application/x-www-form-urlencoded"
        return {"authorization": f"Bearer {self.token}", "content-type": kind}

    def keep_running(self) -> None:
        """Start a test where the last one has ended."""
        for name in self.names:
            page = self.request("GET", f"/stations/{name}")[1].decode()
            if 'id="serial"' in page:
                self._tested += 1
                said = self.request("POST", f"/stations/{name}/start", {"serial": f"WATCH-{self._tested}"})
                assert said[0] == 200, said

    def wait_for_frames(self) -> None:
        """Return once a first frame is stored."""
        query = "SELECT count(*) FROM frame_blocks"
        for _ in range(1200):
            self.keep_running()  # as soon as the page knows that the stations are free
            time.sleep(0.5)
            with suppress(sqlite3.OperationalError), sqlite3.connect(self.database) as store:
                if store.execute(query).fetchone()[0]:
                    return
            if self._tested > 3 * len(self.names):
                break
        raise SystemExit("no frame was stored: runs end before their first one")

    def close(self) -> None:
        """Stop all runs and the server."""
        for name in self.names:
            stop = build_own_command("station", "stop", name)  # also where the server has ended already
            subprocess.run(stop, env=self._environment, capture_output=True, check=False)
        self.process.terminate()
        self.process.wait(30)


class Watch(threading.Thread):
    """Looks at the store, as often as it takes to know when each block of frames was stored."""

    def __init__(self, line: Line) -> None:
        super().__init__(daemon=True)
        self._line, self.seen, self._ended = line, Seen(), False
        self._rows = 0
        self._count: dict[str, int] = {}
        own = line.process.pid  # the command, and the process that it supervises
        children = Path(f"/proc/{own}/task/{own}/children").read_text().split()
        self._pids = [own, *map(int, children)]

    def run(self) -> None:
        store = sqlite3.connect(f"file:{self._line.database}?mode=ro", uri=True, isolation_level=None)
        version, before_s, sampled_s = None, time.time(), 0.0
        while not self._ended:
            now_s = time.time()
            latest = store.execute("PRAGMA data_version").fetchone()[0]
            if latest != version:
                self._read(store, before_s)
            version, before_s = latest, now_s
            if now_s > sampled_s + 1:
                self._sample()
                sampled_s = now_s
            time.sleep(_LOOK_S)
        store.close()

    def _read(self, store: sqlite3.Connection, stored_s: float) -> None:
        query = "SELECT rowid, run, frames, last_s FROM frame_blocks WHERE rowid > ? ORDER BY rowid"
        for row, run, frames, last_s in store.execute(query, (self._rows,)).fetchall():
            self._rows = row
            self._count[run] = self._count.get(run, 0) + frames
            self.seen.stored.setdefault(run, []).append((self._count[run], last_s, stored_s))

    def _sample(self) -> None:
        pages = (int(Path(f"/proc/{pid}/statm").read_text().split()[1]) for pid in self._pids)
        self.seen.memory_MB.append(sum(pages) * os.sysconf("SC_PAGE_SIZE") / 1e6)
        log = self._line.database.with_name(f"{self._line.database.name}-wal")
        self.seen.log_MB.append(log.stat().st_size / 1e6 if log.exists() else 0.0)

    def stretch(self, minutes: float) -> Seen:
        """Keep stations running for a while; return what was seen."""
        self.seen = Seen()
        seen, cpu_s, began_s = self.seen, self._cpu_s(), time.monotonic()
        while time.monotonic() < began_s + 60 * minutes:
            self._line.keep_running()
            time.sleep(1)
        seen.page_share = (self._cpu_s() - cpu_s) / (time.monotonic() - began_s)
        return seen

    def _cpu_s(self) -> float:
        ticks = (
            int(ticks)
            for pid in self._pids
            for ticks in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
        )
        return sum(ticks) / os.sysconf("SC_CLK_TCK")

    def end(self) -> None:
        self._ended = True
        self.join()


def _stream(line: Line, station: str) -> None:
    """Read a page's events, and take each picture, as a browser does; until the server ends."""
    events = HTTPConnection("127.0.0.1", line.port)
    pictures = HTTPConnection("127.0.0.1", line.port)
    try:
        events.request("GET", f"/stations/{station}/events", headers=line.headers())
        for sent in events.getresponse():
            found = re.search(rb'"picture": "([^"]+)"', sent)
            if found:
                pictures.request("GET", found[1].decode(), headers=line.headers())
                pictures.getresponse().read()
    except OSError:
        return


@contextmanager
def viewers(line: Line, count: int) -> Iterator[Any]:
    """Open the pages of stations in turn: the first in a browser, whose page is returned."""
    from playwright.sync_api import sync_playwright

    for index in range(1, count):
        station = line.names[index % len(line.names)]
        threading.Thread(target=_stream, args=(line, station), daemon=True).start()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=_CHROMIUM, args=_ARGUMENTS)
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(f"http://127.0.0.1:{line.port}/stations/{line.names[0]}?token={line.token}")
        page.evaluate(_NOTE_PICTURES)
        yield page
        browser.close()


def _painted(page: Any) -> list[tuple[str, int, float]]:
    """Return the pictures that a page has noted: (run, frame, time [s since 1970])."""
    found = (
        (re.fullmatch(r".*/image/(.+)/(\d+)", address or ""), when) for address, when in page.evaluate("painted")
    )
    return [(match[1], int(match[2]), when / 1000) for match, when in found if match]


def rows(without: Seen, seen: Seen, speed: float, watched_by: str) -> Iterator[Row]:
    """Yield what was measured against what was asked."""
    latency, alone, late = seen.latencies_s(), without.lateness_s(speed), seen.lateness_s(speed)
    yield Row(
        f"a stored frame is on the screen, {len(latency)} blocks",
        "≤ 300 ms",
        f"{_spread(latency)}, {(latency > 0.3).sum()} over 300 ms",
        met=bool(latency.max() <= 0.3),
    )
    yield Row(f"lateness of stored frames, nobody watches, {len(alone)} blocks", "", _spread(alone))
    yield Row(f"lateness of stored frames, {watched_by}, {len(late)} blocks", "", _spread(late))
    yield Row(
        "processor time of the page", "≤ 10 % of a core", f"{100 * seen.page_share:.1f} %", met=seen.page_share <= 0.1
    )
    fifths = (float(np.median(part)) for part in np.array_split(seen.memory_MB, 5))
    yield Row("memory of the page, of each fifth of the time", "", ", ".join(f"{one:.0f} MB" for one in fifths))
    yield Row("write-ahead log", "", f"at most {max(seen.log_MB):.1f} MB")


def _spread(times_s: np.ndarray[Any, Any]) -> str:
    half, most = np.quantile(times_s, [0.5, 0.99])
    return f"median {1000 * half:.0f} ms, 99 % {1000 * most:.0f} ms, maximum {1000 * times_s.max():.0f} ms"


def main(arguments: Sequence[str] | None = None) -> None:
    """Watch a line, and print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.line_watch", description=__doc__)
    parser.add_argument("--stations", type=int, default=2)
    parser.add_argument("--viewers", type=int, default=4)
    parser.add_argument("--minutes", type=float, default=10.0, help="with viewers")
    parser.add_argument("--alone", type=float, default=3.0, help="minutes before, with nobody watching")
    parser.add_argument("--speed", type=float, default=1.0, help="station seconds per second")
    parser.add_argument("--recipe", default="nine-locations")
    parser.add_argument("--kind", default="line-1", help="shipped station to serve several of, e.g. bench-emulated")
    chosen = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(1))  # runs are stopped then too
    with tempfile.TemporaryDirectory() as folder:
        line = Line(Path(folder), chosen.stations, chosen.speed, chosen.recipe, chosen.kind)
        try:
            watch = Watch(line)
            line.wait_for_frames()
            watch.start()
            without = watch.stretch(chosen.alone)
            with viewers(line, chosen.viewers) as page:
                seen = watch.stretch(chosen.minutes)
                seen.painted = _painted(page)
            watch.end()
        finally:
            line.close()
    print(f"{chosen.stations} stations at {chosen.speed:g} station seconds a second, load {os.getloadavg()[0]:.1f}")
    for row in rows(without, seen, chosen.speed, f"{chosen.viewers} viewers"):
        print(row.markdown())


if __name__ == "__main__":
    main()
