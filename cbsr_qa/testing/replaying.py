"""Tests of drivers against a recorded session with the real instrument."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cbsr_qa.domain.errors import InstrumentError, RefusedError
from cbsr_qa.domain.run.station import CheckOutcome
from cbsr_qa.plugin.links.replay import Replay
from cbsr_qa.plugin.links.taps import use_tap
from cbsr_qa.plugin.links.transcript import Pair, Transcript
from cbsr_qa.system.clock import Clock


@contextmanager
def replay_transcript(path: Path | str, clock: Clock) -> Iterator[Transcript]:
    """Have every serial port and VISA resource that is opened meanwhile answer as in a transcript, by its role.

    What a driver sends must be what was sent then; the first that differs is an InstrumentError that names the line.
    AssertionError at the end if an instrument that was opened was sent less than then, or a driver caught that error.
    RefusedError if the transcript is not whole.

    Parameters
    ----------
    path : file of ``cbsr-qa station record``.
    clock : of the driver's context; it advances to the times of the transcript.
    """
    transcript = Transcript.read(path)
    replay = Replay(transcript, None, clock)
    with use_tap(replay):
        yield transcript
    _check_sent(replay)


@contextmanager
def replay_pairs(role: str, pairs: Iterable[Pair], clock: Clock, *, end: bytes = b"\n") -> Iterator[None]:
    """Have the role's serial port or VISA resource answer as pairs (sent, received) of PyMeasure's tests state.

    AssertionError at the end if the driver sent something else, or less. RefusedError names a
    pair that cannot be used.

    Parameters
    ----------
    pairs : bytes, text, octets or numbers; None where nothing is sent, or nothing received.
    clock : as for :func:`replay_transcript`.
    end : of every line, which such pairs leave out.
    """
    replay = Replay(Transcript.from_pairs(role, pairs, end=end), None, clock)
    with use_tap(replay):
        yield
    _check_sent(replay, role)


def assert_replays(station: str, path: Path | str, *, ring_ohm: float | None = None) -> None:
    """Make a station's check again from its transcript. AssertionError names every line that fails.

    RefusedError if the transcript is not whole, its check was stopped, or it is of other instruments.

    Parameters
    ----------
    station : file or name, as at ``cbsr-qa station record``.
    ring_ohm : another one than the transcript states.
    """
    from cbsr_qa.app.station_check.check import replay_check  # other tests need no application
    from cbsr_qa.app.station_check.request import CheckRequest

    if early := Transcript.read(path).early:
        raise RefusedError(f"{path}: {early}", remedy="take a transcript of a whole check")
    results = replay_check(CheckRequest(station, ring_ohm=ring_ohm), Path(path)).result.results
    failed = [f"{line.subject}, {line.name}: {line.said}" for line in results if line.outcome is CheckOutcome.FAILED]
    if failed:
        raise AssertionError("\n".join(failed))


def _check_sent(replay: Replay, role: str = "") -> None:
    """Raise AssertionError if something else was sent than then, or less, also if the role was not even opened."""
    if role:
        with suppress(InstrumentError):
            replay.connect(role, lambda: None)
    if (different := replay.find_difference()) is not None:
        raise AssertionError(different.reason)
