"""Whether a load cell stood at the end of its range while a load was held."""

from typing import Final

import numpy as np

from cbsr_qa.domain.frames import SampleBlock
from cbsr_qa.domain.loads import LoadRecord

#: A hold of fewer samples does not say that a cell stands still.
_FEWEST: Final = 8
#: Share of a hold's samples that are the highest reading of the phase, to the last digit: noise and relaxation would
#: lead away from it.
_SHARE: Final = 0.9


def stood_at_limit(samples: SampleBlock | None, record: LoadRecord) -> str:
    """Say that the cell stood at its highest reading all through a hold; empty where it did not.

    A cell whose readings never differ while nothing presses has no noise (a simulated world without any), and nothing
    can be told from its standing still.
    """
    if samples is None:
        return ""
    held = samples.between(record.hold_start_s, record.release_start_s).values
    if len(held) < _FEWEST:
        return ""
    highest = float(samples.values.max())
    if highest <= 0 or np.mean(held == highest) < _SHARE:
        return ""
    rest = samples.between(record.unloaded_s, record.rest_end_s).values
    if len(rest) < _FEWEST or len(np.unique(rest)) < 2:
        return ""
    return f"the load cell stood at {highest:.4g} N, its highest reading, all through the hold: it is saturated"
