"""A head whose edge is not sharp."""

import numpy as np

from cbsr_qa.domain.scene import HeadRing, SceneSetting, SheetDesign
from cbsr_qa.simulate.parameters import number
from cbsr_qa_plugins.effects._heads import check_nested

_RINGS = 8


class HeadEdge:
    """The strain falls from full to none over a band about the head's edge, linearly; what presses in all is kept.

    Made of eight nested heads of equal weight, whose sizes are the middles of eight parts of the band. The band of a
    head that is not round is so wide where its edge is as far from the axis as that of the disc of equal area.

    Parameters
    ----------
    width_mm : of the band.
    """

    needs: tuple[str, ...] = ()
    perturbs = "sheet"

    def __init__(self, setting: SceneSetting, *, width_mm: float) -> None:
        check_nested(setting.indenter)
        radius_mm = setting.indenter.radius_mm
        self._share = number("width_mm", width_mm, most=1.9 * radius_mm) / radius_mm

    def design(self, design: SheetDesign) -> None:
        """Put the nested heads in the place of each ring."""
        sizes = 1 + self._share * ((np.arange(_RINGS) + 0.5) / _RINGS - 0.5)
        weight = 1 / float((sizes**2).sum())
        design.rings = tuple(
            HeadRing(ring.size * float(size), ring.weight * weight) for ring in design.rings for size in sizes
        )
