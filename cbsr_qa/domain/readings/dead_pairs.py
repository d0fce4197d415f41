"""The rule for dead pairs of electrodes, of recordings, runs and single frames alike.

What a pair should read is known from readings with drive and measurement exchanged, or from the unloaded sheet. A
load changes readings by a part; a pair that hardly drives or measures scales all of its own.
"""

from typing import Final

DEAD: Final = 0.4  #: a pair whose readings follow the expected ones with less than this slope is dead …
SMALL: Final = 0.6  #: … if they also spread by less than this share of what is usual …
SOUND: Final = 0.7  #: … and those of most pairs follow with at least this slope
FEWEST: Final = 6  #: readings of a pair
SILENT: Final = 0.05  #: nothing comes through a pair whose readings spread by less than this share of what is usual
