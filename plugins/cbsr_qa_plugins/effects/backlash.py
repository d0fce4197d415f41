"""Play in the applicator's drives."""

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number


class Backlash:
    """Every axis has play: it follows what it is told only when its play is used up, on the side it came from.

    The play operator (Visintin 1994): the axis stays where it is as long as that is within half of its play from
    where it is told to be; else it stops half of its play short of it.

    Parameters
    ----------
    play_mm : along x and along y.
    depth_play_mm : of the depth.
    """

    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = ("misplaced-sheet",)
    perturbs = "position"

    def __init__(self, setting: SceneSetting, *, play_mm: float, depth_play_mm: float = 0.0) -> None:
        self._play_mm = number("play_mm", play_mm, most=5.0)
        self._depth_play_mm = number("depth_play_mm", depth_play_mm, most=1.0)

    def apply(self, moment: Moment) -> None:
        """Hold the head back."""
        (x, y), (from_x, from_y) = moment.place_mm, moment.from_mm
        moment.place_mm = (_played(x, from_x, self._play_mm), _played(y, from_y, self._play_mm))
        moment.depth_mm = _played(moment.depth_mm, moment.from_depth_mm, self._depth_play_mm)


def _played(to_mm: float, from_mm: float, play_mm: float) -> float:
    return min(max(from_mm, to_mm - play_mm / 2), to_mm + play_mm / 2)
