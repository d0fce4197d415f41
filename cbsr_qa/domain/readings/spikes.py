"""The rule for spikes, of recordings, runs and single frames alike.

A passive sheet is reciprocal: whatever a load does to V_ij it does to V_ji in the same frame. A reading that is far
from where it should be is a spike if the one with drive and measurement exchanged did not go along.
"""

from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array, Mask

SPIKE_SIGMA: Final = 7.0  #: distance from where a reading should be, over the noise
MOST_SPIKES: Final = 0.05  #: largest share of a frame that may be spikes where nothing else tells them from loads
_GOES_ALONG: Final = 0.25  #: a reciprocal reading that moves by this share goes along


def left_alone(change: Array, reciprocal: Array) -> Mask:
    """Whether the reciprocals of readings did not change with them."""
    alone: Mask = reciprocal * np.sign(change) < _GOES_ALONG * np.abs(change)
    return alone
