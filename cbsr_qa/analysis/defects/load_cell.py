"""Load cells at their limit, which read the same, highest force while the press continues, or with a moved zero."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from cbsr_qa.analysis.defects.noise import MAD_TO_SIGMA
from cbsr_qa.domain.readings.frames import SampleBlock
from cbsr_qa.domain.readings.loads import LoadRecord

#: Fewest samples of a hold that show that a cell is stuck.
_MIN_HOLD_SAMPLES: Final = 8
#: Share of a hold's samples that equal the highest reading of the phase exactly: noise and relaxation would move away
#: from it.
_SHARE: Final = 0.9
#: Samples in a row at exactly the highest force that noise cannot explain: a second of the rig's cell.
_MIN_RUN_AT_LIMIT: Final = 8
#: A zero moved if it did by this share of the largest force, and by so many times the noise of a sample.
_ZERO_SHARE: Final = 0.03
_ZERO_NOISES: Final = 3.0


def describe_cell_limit(samples: SampleBlock | None, record: LoadRecord) -> str:
    """Report that the cell stayed at its highest reading throughout a hold; empty otherwise.

    A cell whose unloaded readings never differ has no noise (as in some simulations); its constant readings prove
    nothing.
    """
    if samples is None:
        return ""
    held_forces = samples.select_interval(record.hold_start_s, record.release_start_s).values
    if len(held_forces) < _MIN_HOLD_SAMPLES:
        return ""
    highest = float(samples.values.max())
    if highest <= 0 or np.mean(held_forces == highest) < _SHARE:
        return ""
    rest = samples.select_interval(record.unloaded_s, record.rest_end_s).values
    if len(rest) < _MIN_HOLD_SAMPLES or len(np.unique(rest)) < 2:
        return ""
    return f"the load cell read {highest:.4g} N, its highest reading, throughout the hold: it is saturated"


def describe_zero_shift(samples: SampleBlock | None, records: Sequence[LoadRecord]) -> str:
    """Say by how much the reading of the unloaded cell moved from the first press to the last; empty if hardly.

    The head is up from the end of an unloading ramp to the end of the rest. A cell that is tared before each press
    reads forces correctly all the same, until it does not reach its range any more.
    """
    if samples is None or len(records) < 2:
        return ""
    first, last = records[0], records[-1]
    zeros = [samples.select_interval(record.unloaded_s, record.rest_end_s).values for record in (first, last)]
    if min(map(len, zeros)) < _MIN_HOLD_SAMPLES:
        return ""
    shift_N = float(np.median(zeros[1]) - np.median(zeros[0]))
    largest_N = float(np.abs(samples.values - np.median(zeros[0])).max())
    noise_N = max(MAD_TO_SIGMA * float(np.median(np.abs(zero - np.median(zero)))) for zero in zeros)
    if abs(shift_N) < max(_ZERO_SHARE * largest_N, _ZERO_NOISES * noise_N):
        return ""
    return (
        f"the load cell's zero moved by {shift_N:.2g} N from press {first.load.label} to press {last.load.label}:"
        " tare it, and check its mount and cable"
    )


def limit_N(samples: SampleBlock, loads: tuple[LoadRecord, ...]) -> float | None:
    """Highest force, if many samples in a row equal it while the others vary.

    Without noise a held force is constant too: it is then a limit only if holds of several strains end there.
    """
    if not len(samples):
        return None
    highest = float(samples.values.max())
    at_limit = samples.values == highest
    edges = np.flatnonzero(np.diff(np.concatenate([[False], at_limit, [False]]).astype(np.int8)))
    longest_run = int((edges[1::2] - edges[::2]).max(initial=0))
    if highest <= 0 or longest_run < _MIN_RUN_AT_LIMIT:
        return None
    below_limit = samples.values[~at_limit]
    often_repeats = len(below_limit) > 1 and float((np.diff(below_limit) == 0).mean()) > 0.5
    strains = {
        load.load.strain
        for load in loads
        if (samples.select_interval(load.hold_start_s, load.release_start_s).values == highest).any()
    }
    return highest if not often_repeats or len(strains) > 1 else None
