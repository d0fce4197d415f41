"""Readings that respond to presses: behind a rectifying front end, those of one polarity do not."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array, Mask

#: Readings of one modelled polarity hardly respond if those of the other are larger by this factor, both relative to
#: the modelled sheet.
_DEAD: Final = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class AnsweringSide:
    """Readings that respond to a press.

    Parameters
    ----------
    answers : (m,) False for those that never do, and those of a polarity that hardly responds.
    words : description; empty if both polarities respond.
    """

    answers: Mask
    words: str = ""


def compare_sides(answer: Array, positive: Mask) -> AnsweringSide:
    """Compare readings of both modelled polarities.

    Parameters
    ----------
    answer : (m,) size of each reading over the modelled one, any unit.
    positive : (m,) mask of readings whose modelled voltage is positive.
    """
    if positive.all() or not positive.any():
        return AnsweringSide(np.ones_like(positive))
    sizes = [float(np.median(answer[side])) for side in (positive, ~positive)]
    if max(sizes) <= _DEAD * min(sizes):
        return AnsweringSide(np.ones_like(positive))
    dead_mask, name = (~positive, "negative") if sizes[0] > sizes[1] else (positive, "positive")
    finding = (
        f"{int(dead_mask.sum())} readings whose modelled voltage is {name} hardly respond:"
        f" {min(sizes) / max(sizes):.1%} of what the others do, both compared with the modelled sheet;"
        " the front end appears to rectify"
    )
    return AnsweringSide(~dead_mask, finding)
