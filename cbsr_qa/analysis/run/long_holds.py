"""The longest holds of a run: what kernels of its sensor, or of its batch, are learned from."""

from dataclasses import dataclass

import numpy as np

from cbsr_qa.analysis.run.compensation import LONG, force_rises, force_trace
from cbsr_qa.analysis.run.force import force_loads, strength_traces
from cbsr_qa.analysis.run.force_kernels import Transients, steady_s
from cbsr_qa.domain.results.observation import RunObservation


@dataclass(frozen=True, slots=True, eq=False)
class LongHolds:
    """The longest holds of a run, which its kernels are learned from.

    Parameters
    ----------
    hold_s, steady_s : how long they were held, and the time after the press at which they are evaluated.
    rises, decays, forces : conductance under the hold and after it, and force; None without data.
    """

    hold_s: float
    steady_s: float
    rises: Transients
    decays: Transients | None
    forces: Transients | None


def find_long_holds(run: RunObservation) -> LongHolds:
    """Return the longest holds of a run. CbsrError if it has no load with a force, or no noise."""
    every, _ = force_loads(run)
    longest_s = max(load.hold_s for load in every)
    loads = [load for load in every if load.hold_s >= LONG * longest_s]
    strengths = strength_traces(run)
    return LongHolds(
        longest_s,
        float(np.mean([steady_s(run, load) for load in loads])),
        strengths.rises(loads),
        strengths.decays(loads),
        force_rises(loads, [force_trace(run, load) for load in loads]),
    )
