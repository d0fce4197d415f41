"""Dead drive pairs: most of the current never reaches the sheet.

All readings of such a drive are a fraction of what they should be. A passive sheet is reciprocal: V_ij, driven at
pair i, equals V_ji, driven at pair j. So the row of a dead drive is a fraction of its own column, whatever the sheet.
"""

from dataclasses import dataclass

import numpy as np

from cbsr_qa.analysis.defects.noise import MAD_TO_SIGMA
from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.domain.readings.rules import DEAD_SLOPE, DEAD_SPREAD, FEWEST_OF_PAIR, SOUND_SLOPE

_FOLLOWS = 0.8  #: correlation of the typical drive below which slopes mean nothing
_OFF_LINE = 4.0  #: robust standard deviations from its line at which a reading does not count
_ROUNDING = 1e-9  #: of the largest reading: deviations below are rounding
_AWAY = 0.5  #: a dead drive's own reading is wrapped if it differs by this share of the typical one


@dataclass(frozen=True, slots=True)
class DeadDrive:
    """A drive pair that hardly drives.

    Parameters
    ----------
    share : share of the current that reaches the sheet, from its readings over their reciprocals.
    own, usual_own : reading of the pair while it is driven itself, and the usual value of the others, as recorded.
    """

    drive: int
    share: float
    own: float
    usual_own: float

    @property
    def wrapped(self) -> bool:
        """Return whether its own reading is far from that of the other drives."""
        return abs(self.own - self.usual_own) > _AWAY * abs(self.usual_own)

    def words(self, unit: str) -> str:
        """Name the drive and what was observed; readings in ``unit``."""
        own_words = (
            f", and its own is {self.own:.5g} {unit} where {self.usual_own:.5g} is usual" if self.wrapped else ""
        )
        return (
            f"drive pair {self.drive} is dead: its readings are {self.share:.0%} of those with drive and measurement"
            f" exchanged{own_words}; they were left out: check row {self.drive} of the board and its leads"
        )


def find_dead_drives(frame: Array, used: Mask) -> tuple[DeadDrive, ...]:
    """Find drives whose readings are a fraction of their reciprocals.

    Parameters
    ----------
    frame : (pairs, pairs), the typical one, carry-over taken out; the same pairs drive and measure. An offset on all
        readings does not matter.
    used : (pairs, pairs) bool, sound readings that touch no driven electrode.

    Returns
    -------
    The answer; None if the readings are not reciprocal enough to decide, because of noise or carry-over.
    """
    both_mask = used & used.T
    drives = np.flatnonzero(both_mask.sum(axis=1) >= FEWEST_OF_PAIR)
    if len(drives) < FEWEST_OF_PAIR:
        return ()
    lines = [_fit_line(frame[both_mask[:, k], k], frame[k, both_mask[k]]) for k in drives]
    slopes, follow, columns, rows = np.array(lines).T
    if np.median(slopes) < SOUND_SLOPE or np.median(follow) < _FOLLOWS:
        return ()
    own_readings = np.diag(frame)
    # A measure pair that reads too much has a row as large as others; a lost contact has a small column too.
    dead = drives[
        (slopes < DEAD_SLOPE) & (rows < DEAD_SPREAD * np.median(rows)) & (columns > DEAD_SPREAD * np.median(columns))
    ]
    usual = float(np.median(np.delete(own_readings, dead)))
    return tuple(DeadDrive(int(k), float(slopes[drives == k][0]), float(own_readings[k]), usual) for k in dead)


def _fit_line(reciprocal: Array, reading: Array) -> tuple[float, float, float, float]:
    """Slope of readings over their reciprocals, their correlation, and the standard deviations of both.

    The slope is the median of those between any two readings (Theil and Sen), weighted by their distance up to the
    usual one: a dead drive spoils one reading of every other. Readings off this line are left out of the rest.
    """
    first, second = np.triu_indices(len(reading), 1)
    apart, differ = reciprocal[second] - reciprocal[first], reading[second] - reading[first]
    power, reading_power = float(apart @ apart), float(differ @ differ)
    if power == 0 or reading_power == 0:
        slope = 0.0 if reading_power == 0 < power else 1.0
        return slope, float(reading_power == power), float(reciprocal.std()), float(reading.std())
    distances = np.abs(apart[apart != 0])
    ratios = differ[apart != 0] / apart[apart != 0]
    order = np.argsort(ratios)
    weight = np.cumsum(np.minimum(distances, np.median(distances))[order])
    slope = float(ratios[order][np.searchsorted(weight, weight[-1] / 2)])
    left = reading - slope * reciprocal
    left = np.abs(left - np.median(left))
    on_line = left <= max(_OFF_LINE * MAD_TO_SIGMA * float(np.median(left)), _ROUNDING * float(np.abs(reading).max()))
    x, y = reciprocal[on_line] - reciprocal[on_line].mean(), reading[on_line] - reading[on_line].mean()
    size = float(np.linalg.norm(x) * np.linalg.norm(y))
    return slope, float(x @ y) / size if size else 0.0, float(x.std()), float(y.std())
