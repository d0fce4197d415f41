"""How many frames fit a hold: one rule for the dry run and for the hold itself."""

import math
from typing import Final

#: A frame is begun only if more than this share of it lies inside the hold. Without it the rounding of the
#: clock would decide whether a hold of exactly 24 frames takes 24 or 25.
WORTHWHILE: Final = 0.1


def another_frame(left_s: float, frame_period_s: float) -> bool:
    """Whether to begin one more frame with this much of the hold left."""
    return left_s > WORTHWHILE * frame_period_s


def frames_in_hold(hold_s: float, frame_period_s: float) -> int:
    """Return how many frames a hold takes: one after the other until it is over, at least one."""
    return max(1, math.ceil(hold_s / frame_period_s - WORTHWHILE))
