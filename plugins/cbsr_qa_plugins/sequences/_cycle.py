"""Runs of steps that every built-in sequence is made of."""

from collections.abc import Iterable, Iterator

from cbsr_qa.domain.loads import Load
from cbsr_qa.domain.steps import AcquireFrames, FindSurface, Hold, MarkUnloaded, Press, Release, Step


def find_surfaces(places_mm: Iterable[tuple[float, float]]) -> Iterator[Step]:
    """Find the surface at each different place, in the order they first occur."""
    for x_mm, y_mm in dict.fromkeys(places_mm):
        yield FindSurface(x_mm, y_mm)


def unloaded(rest_s: float, frames: int) -> Iterator[Step]:
    """Let the sheet rest, then take the frames that noise floor and reference come from.

    The rest itself takes no frames: nothing is drawn from them, and they would only fill the store.
    """
    if rest_s > 0:
        yield Hold(rest_s, acquire=False)
    yield MarkUnloaded()
    yield AcquireFrames(frames)


def press_cycle(load: Load, *, hold_s: float, rest_s: float) -> Iterator[Step]:
    """Press, hold, release and rest, taking frames through hold and rest (paper: 60 s on, 60 s off)."""
    yield Press(load)
    yield Hold(hold_s, acquire=True)
    yield Release()
    if rest_s > 0:
        yield Hold(rest_s, acquire=True)
