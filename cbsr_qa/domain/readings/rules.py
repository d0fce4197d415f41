"""The rules for dead pairs of electrodes and for spikes, of recordings, runs and single frames alike.

The expected readings of a pair are those with drive and measurement exchanged, or those of the unloaded sheet. A
load changes readings by a part; a pair that hardly drives or measures scales all of its own.

A passive sheet is reciprocal: whatever a load does to V_ij it does to V_ji in the same frame. A reading that is far
from where it should be is a spike if the one with drive and measurement exchanged did not go along.
"""

from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array, Mask

#: A pair is dead if its readings follow the expected ones with less than this slope …
DEAD_SLOPE: Final = 0.4
#: … and spread by less than this share of what is usual, …
DEAD_SPREAD: Final = 0.6
#: … while those of most pairs follow with at least this slope.
SOUND_SLOPE: Final = 0.7
#: Fewest readings that a pair is judged by.
FEWEST_OF_PAIR: Final = 6
#: Share of the usual spread of readings below which nothing comes through a pair.
SILENT_SPREAD: Final = 0.05

SPIKE_SIGMA: Final = 7.0  #: distance from where a reading should be, over the noise
MOST_SPIKES: Final = 0.05  #: largest share of a frame that may be spikes where nothing else tells them from loads
_GOES_ALONG: Final = 0.25  #: a reciprocal reading that moves by this share goes along


def reciprocal_unchanged(change: Array, reciprocal: Array) -> Mask:
    """Whether the reciprocals of readings did not change with them."""
    return reciprocal * np.sign(change) < _GOES_ALONG * np.abs(change)
