"""Tests of drivers against a recorded session with the real instrument."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from cbsr_qa.domain.run.station import CheckOutcome
from cbsr_qa.plugin.links.replay import Replay
from cbsr_qa.plugin.links.taps import use_tap
from cbsr_qa.plugin.links.transcript import Pair, Transcript
from cbsr_qa.system.clock import Clock


@contextmanager
def replay_transcript(path: Path, clock: Clock) -> Iterator[Transcript]:
    """Have every serial port and VISA resource that is opened meanwhile answer as in a transcript, by its role.

    What a driver sends must be what was sent then; the first that differs is an InstrumentError that names the line.
    RefusedError if the transcript is not whole.

    Parameters
    ----------
    path : file of ``cbsr-qa station record``.
    clock : of the driver's context; it advances to the times of the transcript.
    """
    transcript = Transcript.read(path)
    with use_tap(Replay(transcript, None, clock)):
        yield transcript


@contextmanager
def replay_pairs(role: str, pairs: Iterable[Pair], clock: Clock, *, end: bytes = b"\n") -> Iterator[None]:
    """Have the role's serial port or VISA resource answer as pairs (sent, received) of PyMeasure's tests state.

    Parameters
    ----------
    pairs : bytes or text; None where nothing is sent, or nothing received.
    clock : as for :func:`replay_transcript`.
    end : of every line, which such pairs leave out.
    """
    with use_tap(Replay(Transcript.from_pairs(role, pairs, end=end), None, clock)):
        yield


def assert_replays(station: str, path: Path, *, ring_ohm: float | None = None) -> None:
    """Make a station's check again from its transcript. AssertionError names every line that fails.

    RefusedError if the transcript is not whole, or of other instruments.

    Parameters
    ----------
    station : file or name, as at ``cbsr-qa station record``.
    ring_ohm : as given there.
    """
    from cbsr_qa.app.station_check.check import CheckRequest, replay_check  # other tests need no application

    results = replay_check(CheckRequest(station, ring_ohm=ring_ohm), path).result.results
    failed = [f"{line.subject}, {line.name}: {line.said}" for line in results if line.outcome is CheckOutcome.FAILED]
    if failed:
        raise AssertionError("\n".join(failed))
