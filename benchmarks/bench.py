"""The bench: what the drivers cost beyond the time their instruments take."""

import time
from collections.abc import Iterator
from types import TracebackType
from typing import Final, Self

from benchmarks.rows import Row
from benchmarks.timing import shown
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.simulate.instruments.rig import Emulation
from cbsr_qa.station.setup import configure, open_station, station_clock

TITLE = "Bench"

_FRAMES: Final = 20
_GOAL_S: Final = 1e-3


class EmulatedStation:
    """The shipped emulated station, opened; a context manager."""

    def __enter__(self) -> Self:
        plugins = discover()
        here = configure("bench-emulated", "nine-locations", sensor_type=None, material=None, seed=1)
        self.pattern = here.sensor_type.pattern
        self.clock = station_clock(here)
        self._bench = open_station(here, plugins, self.clock, emulated=self._take)
        self.frames = self._bench.frame_source
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bench.safe_state()
        self._bench.close()

    def _take(self, emulation: Emulation) -> None:
        self.emulation = emulation

    def instruments_s(self) -> float:
        """Time the emulated instruments spend on one frame, bytes in to bytes out [s, real time]."""
        spent = [0.0]
        for role in ("source_meter", "multiplexer"):
            instrument = self.emulation.instruments[role]
            received = instrument.receive

            def timed(data: bytes, received=received) -> bytes:  # type: ignore[no-untyped-def]
                before = time.perf_counter()
                said = received(data)
                spent[0] += time.perf_counter() - before
                return bytes(said)

            instrument.receive = timed  # type: ignore[method-assign]
        best = float("inf")
        for _ in range(_FRAMES):
            spent[0] = 0.0
            self.frames.acquire(1)
            best = min(best, spent[0])
        return best


def rows() -> Iterator[Row]:
    """Time one frame of 256 readings, and what of it is not the emulated instruments' own."""
    with EmulatedStation() as station:
        count = station.pattern.shape[0] * station.pattern.shape[1]
        frame_s = min(_taken_s(station) for _ in range(_FRAMES))
        own_s = station.instruments_s()
        each_s = (frame_s - own_s) / count
        yield Row(
            f"our share of one reading of a source-measure unit behind a multiplexer, mean of {count}, over a socket"
            " and a pseudo terminal",
            f"≤ {shown(_GOAL_S)}",
            f"{shown(each_s)} beyond the emulated instruments' {shown(own_s / count)}",
            met=each_s <= _GOAL_S,
        )


def _taken_s(station: EmulatedStation) -> float:
    before = time.perf_counter()
    station.frames.acquire(1)
    return time.perf_counter() - before
