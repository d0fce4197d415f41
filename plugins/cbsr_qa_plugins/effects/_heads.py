"""What a head is for effects that make it of smaller and larger outlines of the same shape."""

import numpy as np

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.loads import Indenter

_ROUNDING = 1e-9  # of the square of the head's reach


def check_nested(indenter: Indenter) -> None:
    """Refuse a head whose smaller outlines do not lie within the larger ones: one that its axis does not see whole.

    Raises
    ------
    ConfigError
        Naming the edge.
    """
    if not indenter.outline_mm:
        return
    corners = np.array(indenter.outline_mm)
    x_mm, y_mm = corners.T
    next_x_mm, next_y_mm = np.roll(corners, -1, axis=0).T
    seen_mm2 = x_mm * next_y_mm - y_mm * next_x_mm  # twice the area that an edge spans with the axis
    worst = int(seen_mm2.argmin())
    if seen_mm2[worst] < -_ROUNDING * indenter.reach_mm**2:
        raise ConfigError(
            f"the head's edge after its corner ({x_mm[worst]:g}, {y_mm[worst]:g}) mm is seen from behind by its axis:"
            " smaller outlines of its shape do not lie within larger ones",
            remedy="take an axis from which straight lines to all of the outline lie within the head",
        )
