"""A board that prints its log into the readings."""

from cbsr_qa.domain.scene import Dump, SceneSetting, Transcript
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.streams import RandomStream


class WatchdogDump:
    """At random moments the board's watchdog prints a log, and the board reads on when it is printed.

    Their number in each frame is Poisson distributed, and each stands before any of its rows alike.

    Parameters
    ----------
    per_minute : how many on average while frames are taken, 0 to 600. The lab's boards print
        12, one every 5.000 s, which these are not.
    pause_ms : how long printing takes, 0 to 10 000 ms. Frames of the lab with a dump in them take 70 to 80 ms longer.
    """

    needs: tuple[str, ...] = ()
    perturbs = "recording"

    def __init__(self, setting: SceneSetting, *, per_minute: float, pause_ms: float = 75.0) -> None:
        self._rows = setting.sensor_type.pattern.shape[0]
        self._per_frame = number("per_minute", per_minute, most=600.0) / 60 * setting.frame_period_s
        self._pause_s = number("pause_ms", pause_ms, most=10_000.0) / 1000
        self._stream = RandomStream(setting.seed, "watchdog-dump")

    def record(self, transcript: Transcript) -> None:
        """Add the dumps, frame by frame."""
        for frame in range(len(transcript.lost)):
            numbers = self._stream.generator(frame)
            rows = sorted(numbers.integers(self._rows, size=numbers.poisson(self._per_frame)).tolist())
            transcript.dumps += [Dump(frame, row, self._pause_s) for row in rows]
