"""Play in the applicator's drives."""

import math

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number


class Backlash:
    """Every axis stops half of its play short of where it is told, on the side it came from.

    An axis that did not move is in the middle of its play: what it did before is not remembered.

    Parameters
    ----------
    play_mm : along x and along y.
    depth_play_mm : of the depth.
    """

    needs: tuple[str, ...] = ()
    perturbs = "position"

    def __init__(self, setting: SceneSetting, *, play_mm: float, depth_play_mm: float = 0.0) -> None:
        self._play_mm = number("play_mm", play_mm, most=5.0)
        self._depth_play_mm = number("depth_play_mm", depth_play_mm, most=1.0)

    def apply(self, moment: Moment) -> None:
        """Hold the head back."""
        (x, y), (from_x, from_y) = moment.place_mm, moment.from_mm
        moment.place_mm = (_short(x, from_x, self._play_mm), _short(y, from_y, self._play_mm))
        moment.depth_mm = _short(moment.depth_mm, moment.from_depth_mm, self._depth_play_mm)


def _short(to_mm: float, from_mm: float, play_mm: float) -> float:
    return to_mm if to_mm == from_mm else to_mm - math.copysign(play_mm / 2, to_mm - from_mm)
