"""A load cell that ends."""

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number


class LoadCellSaturation:
    """Forces beyond the cell's limit read as the limit (the rig's ends at 749 g, 7.35 N).

    Parameters
    ----------
    limit_N : to both sides.
    """

    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = ("load-cell-noise",)
    perturbs = "force"

    def __init__(self, setting: SceneSetting, *, limit_N: float) -> None:
        self._limit_N = number("limit_N", limit_N, above=True)

    def apply(self, moment: Moment) -> None:
        """Clip."""
        moment.force_N = min(max(moment.force_N, -self._limit_N), self._limit_N)
