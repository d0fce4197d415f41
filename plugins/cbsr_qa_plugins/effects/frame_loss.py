"""Rows of a frame that never arrive."""

from cbsr_qa.domain.scene import SceneSetting, Transcript
from cbsr_qa.simulate.parameters import number, whole
from cbsr_qa.simulate.streams import RandomStream


class FrameLoss:
    """Every frame, with the same probability, loses a run of rows from a random one on; its other rows arrive.

    Where the run begins and how long it is are uniform; the end of the frame cuts it.

    Parameters
    ----------
    share : of the frames that lose rows, 0 to 1.
    most_rows : longest run, 1 to the rows of a frame. The lab's recordings miss one to four rows of a broken frame.
    """

    needs: tuple[str, ...] = ()
    perturbs = "recording"

    def __init__(self, setting: SceneSetting, *, share: float, most_rows: int = 4) -> None:
        self._rows = setting.sensor_type.pattern.shape[0]
        self._share = number("share", share, most=1.0)
        self._most_rows = whole("most_rows", most_rows, least=1, most=self._rows)
        self._stream = RandomStream(setting.seed, "frame-loss")

    def record(self, transcript: Transcript) -> None:
        """Mark the rows as lost."""
        for frame in range(len(transcript.lost)):
            numbers = self._stream.generator(frame)
            if numbers.random() < self._share:
                first = int(numbers.integers(self._rows))
                transcript.lost[frame, first : first + 1 + int(numbers.integers(self._most_rows))] = True
