"""State that all requests share: the stations with their channels, the watching thread, and the open pages."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

from cbsr_qa.config.paths import database_url
from cbsr_qa.web.channel import ChannelClient
from cbsr_qa.web.stations import ServedStation
from cbsr_qa.web.watching import StationWatch, Watcher

#: Most pages that may be open at once: all, and those that may only look.
MAX_VIEWERS = 256
MAX_READ_ONLY_VIEWERS = 192


@dataclass(eq=False)
class Viewer:
    """An open page.

    Parameters
    ----------
    station : name of the station it shows; None for all.
    control : whether it may control.
    news : event that is set when there is something new.
    """

    station: str | None
    control: bool
    news: asyncio.Event = field(default_factory=asyncio.Event)


class Line:
    """The stations that are served. Belongs to one event loop.

    Parameters
    ----------
    database : option of the command; None for the default.
    """

    def __init__(self, served: Sequence[ServedStation], database: str | None) -> None:
        self.database = database
        self.viewers: set[Viewer] = set()
        self.stations = {
            station.name: StationWatch(station, ChannelClient(station.name, partial(self.wake, station.name)))
            for station in served
        }
        self._watcher = Watcher(tuple(self.stations.values()), database_url(database), self._publish)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def trouble(self) -> str:
        """Reason why the store cannot be read; empty if it can."""
        return self._watcher.trouble

    def runs_in_progress(self) -> frozenset[str]:
        """Return the runs in progress."""
        snapshots = (one.snapshot for one in self.stations.values())
        return frozenset(
            one.look.run for one in snapshots if one is not None and one.look is not None and one.mode.live
        )

    def runs_to_resume(self) -> dict[str, str]:
        """Return the runs that can be resumed, with their stations: only of a latest run may the sensor lie there."""
        snapshots = [one.snapshot for one in self.stations.values() if one.snapshot is not None]
        return {one.look.run: one.station for one in snapshots if one.look is not None and one.resumable}

    async def open(self) -> None:
        """Begin to watch."""
        self._loop = asyncio.get_running_loop()
        self._tasks = [asyncio.create_task(station.channel.follow()) for station in self.stations.values()]
        self._watcher.start()

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await asyncio.to_thread(self._watcher.stop)

    def wake(self, station: str) -> None:
        """Look at a station soon: something was started or asked, or its run says something new."""
        self.stations[station].wake()
        self._watcher.wake()

    def _publish(self, names: list[str]) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._tell, frozenset(names))

    def _tell(self, names: frozenset[str]) -> None:
        for viewer in self.viewers:
            if viewer.station is None or viewer.station in names:
                viewer.news.set()
