"""A board that prints its log into the readings."""

import numpy as np

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.scene import Dump, SceneSetting, Transcript
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.streams import RandomStream


class WatchdogDump:
    """At regular times the board's watchdog prints a log, and the board reads on when it is printed.

    A dump stands before the first row that would be read after its time, rows being spread evenly over their frame.
    When the first one comes is drawn once per seed.

    Parameters
    ----------
    period_s : from one dump to the next on the board's own clock; by its log the lab's board prints one every
        5.000 s.
    pause_ms : how long printing takes, up to 10 000 ms and less than the period. Frames of the lab with a dump in
        them take 70 to 80 ms longer.
    """

    needs: tuple[str, ...] = ()
    perturbs = "recording"

    def __init__(self, setting: SceneSetting, *, period_s: float = 5.0, pause_ms: float = 75.0) -> None:
        self._period_s = number("period_s", period_s, least=0.1, most=1e6)
        self._pause_s = number("pause_ms", pause_ms, most=10_000.0) / 1000
        if self._pause_s >= self._period_s:
            raise ConfigError(
                f"pause_ms is {pause_ms!r}, which is not over before the next dump after {period_s:g} s",
                remedy="take a shorter pause_ms, or a longer period_s",
            )
        self._frame_s = setting.frame_period_s
        self._first_s = self._period_s * float(RandomStream(setting.seed, "watchdog-dump").generator(0).uniform())

    def record(self, transcript: Transcript) -> None:
        """Add the dumps, one after the other."""
        frames, rows = transcript.lost.shape
        if not frames:
            return
        since_s = transcript.time_s - transcript.time_s[0]
        planned_s = (since_s[:, None] + np.arange(rows) / rows * self._frame_s).ravel()
        late_s, due_s = 0.0, self._first_s
        while (place := int(np.searchsorted(planned_s, due_s - late_s))) < frames * rows:
            frame, row = divmod(place, rows)
            transcript.dumps.append(Dump(frame, row, self._pause_s))
            late_s, due_s = late_s + self._pause_s, due_s + self._period_s
