"""The rule for dead pairs of electrodes, of recordings, runs and single frames alike.

What a pair should read is known from readings with drive and measurement exchanged, or from the unloaded sheet. A
load changes readings by a part; a pair that hardly drives or measures scales all of its own.
"""

from typing import Final

#: A pair is dead if its readings follow the expected ones with less than this slope …
DEAD_SLOPE: Final = 0.4
#: … and spread by less than this share of what is usual, …
DEAD_SPREAD: Final = 0.6
#: … while those of most pairs follow with at least this slope.
SOUND_SLOPE: Final = 0.7
#: Readings that a pair is judged by, at least.
FEWEST_OF_PAIR: Final = 6
#: Nothing comes through a pair whose readings spread by less than this share of what is usual.
SILENT_SPREAD: Final = 0.05
