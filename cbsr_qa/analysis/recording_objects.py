"""Objects in a tank, against a frame of the empty tank: still images, and objects that move."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.recording_places import Matcher, Place, find_places

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_DETECTED = 6.0  #: product of pattern and change over the noise from which an object counts
_EXPLAINED = 0.25  #: and the share of the change it must explain
_EXPLAINED_MOVING = 0.15  #: the same where an object is followed: frames support each other
_BRIDGED_FRAMES = 2  #: frames in which an object was not seen that do not end it


@dataclass(frozen=True, slots=True, eq=False)
class Object:
    """An object, as long as it is there.

    Parameters
    ----------
    first, last, peak : frames; ``peak`` is where it shows most.
    place : at its peak.
    score : at its peak, over the noise.
    track : (frame, place) of every frame it was seen in; a single one for a still image.
    """

    first: int
    last: int
    peak: int
    place: Place
    score: float
    track: tuple[tuple[int, Place], ...]


def reciprocal_noise(changes: Array, used: Mask) -> float:
    """Noise of one reading from what is not reciprocal in changes of a passive tank.

    Parameters
    ----------
    changes : (n, m) of used readings. used : (drives, measures) with m True entries.

    Returns
    -------
    Rms over pairs of (y_ij − y_ji)/√2, in the changes' unit; 0 where no reading has its counterpart.
    """
    full = np.zeros((len(changes), *used.shape))
    full[:, used] = changes
    both = used & used.T
    if not both.any():
        return 0.0
    return float(np.sqrt(np.mean((full - full.swapaxes(1, 2))[:, both] ** 2) / 2))


def find_still(change: Array, match: Matcher) -> tuple[tuple[Object, ...], str]:
    """Find the objects of one still image.

    Parameters
    ----------
    change : (m,) whitened.

    Returns
    -------
    The objects, and why there is none where there is none.
    """
    places, explained = find_places(change, match)
    if not places or abs(places[0].score) < _DETECTED or explained < _EXPLAINED:
        score = abs(places[0].score) if places else 0.0
        return (), (
            f"nothing stands out of what is not reciprocal: the best place scores {score:.1f}"
            f" (at least {_DETECTED:g} is needed) and explains {explained:.0%} of the change"
            f" (at least {_EXPLAINED:.0%})"
        )
    kept = [place for place in places if abs(place.score) >= _DETECTED]
    return tuple(Object(0, 0, 0, place, abs(place.score), ((0, place),)) for place in kept), ""


def find_moving(changes: Array, match: Matcher) -> tuple[tuple[Object, ...], str]:
    """Follow one object through frames.

    Parameters
    ----------
    changes : (n, m) whitened changes against the empty tank.

    Returns
    -------
    One object per stretch in which it is seen, and why there is none where there is none.
    """
    seen: list[tuple[int, Place]] = []
    best = 0.0
    for k, change in enumerate(changes):
        places, explained = find_places(change, match, most=1)
        if places:
            best = max(best, abs(places[0].score))
            if abs(places[0].score) >= _DETECTED and explained >= _EXPLAINED_MOVING:
                seen.append((k, places[0]))
    if not seen:
        return (
            (),
            f"nothing stands out of the noise: the best frame scores {best:.1f}, at least {_DETECTED:g} is needed",
        )
    stretches: list[list[tuple[int, Place]]] = [[seen[0]]]
    for before, after in pairwise(seen):
        if after[0] - before[0] > _BRIDGED_FRAMES + 1:
            stretches.append([])
        stretches[-1].append(after)
    return tuple(_object(stretch) for stretch in stretches), ""


def _object(stretch: list[tuple[int, Place]]) -> Object:
    peak, place = max(stretch, key=lambda one: abs(one[1].score))
    return Object(stretch[0][0], stretch[-1][0], peak, place, abs(place.score), tuple(stretch))
