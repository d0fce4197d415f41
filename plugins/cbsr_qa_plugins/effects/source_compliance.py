"""A current source whose voltage ends."""

import numpy as np

from cbsr_qa.domain.frames import ReadingFlag
from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number


class SourceCompliance:
    """A driven pair that asks for more than the source's voltage limit gets what the limit drives, and is flagged.

    I = V_limit/R.

    Parameters
    ----------
    limit_V : of the source; the rig's is 20 to 22 V.
    """

    needs: tuple[str, ...] = ()
    perturbs = "source"

    def __init__(self, setting: SceneSetting, *, limit_V: float = 20.0) -> None:
        self._limit_V = number("limit_V", limit_V, above=True)

    def apply(self, moment: Moment) -> None:
        """Lower the current of those pairs."""
        if moment.current_A is None or moment.drive_ohm is None or moment.flags is None:
            return
        limited = moment.current_A * moment.drive_ohm > self._limit_V
        moment.current_A = np.divide(self._limit_V, moment.drive_ohm, out=moment.current_A.copy(), where=limited)
        moment.flags |= np.where(limited, np.uint8(ReadingFlag.COMPLIANCE), np.uint8(0))
