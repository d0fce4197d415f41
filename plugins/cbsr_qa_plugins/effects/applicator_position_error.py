"""An applicator that does not get quite where it is told."""

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.streams import RandomStream


class ApplicatorPositionError:
    """The head gets beside its target by Gaussian errors of place and depth, fresh with every movement.

    Parameters
    ----------
    error_mm : standard deviation along x and along y.
    depth_error_mm : of the depth.
    """

    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = ("misplaced-sheet",)
    perturbs = "position"

    def __init__(self, setting: SceneSetting, *, error_mm: float, depth_error_mm: float = 0.0) -> None:
        self._error_mm = number("error_mm", error_mm, most=5.0)
        self._depth_error_mm = number("depth_error_mm", depth_error_mm, most=1.0)
        self._stream = RandomStream(setting.seed, "applicator-position-error")

    def apply(self, moment: Moment) -> None:
        """Put the head beside its target."""
        x, y, depth = self._stream.normal(moment.index, (3,))
        moment.place_mm = (
            moment.place_mm[0] + self._error_mm * float(x),
            moment.place_mm[1] + self._error_mm * float(y),
        )
        moment.depth_mm += self._depth_error_mm * float(depth)
