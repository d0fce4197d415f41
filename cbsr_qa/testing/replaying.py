"""Tests of drivers against a recorded session with the real instrument."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cbsr_qa.plugin.links.replay import Replay
from cbsr_qa.plugin.links.taps import use_tap
from cbsr_qa.plugin.links.transcript import Transcript
from cbsr_qa.system.clock import Clock


@contextmanager
def replay_transcript(path: Path, clock: Clock) -> Iterator[Transcript]:
    """Have every serial port and VISA resource that is opened meanwhile answer as in a transcript, by its role.

    A driver that sends something else than was sent then meets a link that is down, with the line in its error.
    RefusedError if the transcript is not whole.

    Parameters
    ----------
    path : file of ``cbsr-qa station record``.
    clock : of the driver's context; it advances to the times of the transcript.
    """
    transcript = Transcript.read(path)
    with use_tap(Replay(transcript, None, clock)):
        yield transcript
