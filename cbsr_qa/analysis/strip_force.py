"""Stress of press cycles, as far as the load cell could follow."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.frames import SampleBlock
from cbsr_qa.domain.loads import LoadRecord
from cbsr_qa.domain.run import PhaseRecord

Array = NDArray[np.float64]

#: Samples are averaged into this many points a hold: ten times fewer than the load cell's, and enough for seconds.
_POINTS: Final = 60
_FEWEST: Final = 8
#: Samples in a row at exactly the highest force that no noise leaves there: a second of the rig's cell.
_FLAT: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class HeldStress:
    """Stress through one hold: (n,) times from its start, and stress; empty where ``why`` says why not."""

    time_s: Array
    stress_kPa: Array
    why: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class StripForce:
    """The force of a phase.

    Parameters
    ----------
    samples : of the load cell; None where there is none.
    area_mm2 : that is pressed.
    limit_N : force at which the load cell ends; None where it never did.
    """

    samples: SampleBlock | None
    area_mm2: float
    limit_N: float | None

    @property
    def notes(self) -> tuple[str, ...]:
        """What is wrong with the force as a whole."""
        return () if self.samples is not None else ("no force was recorded: nothing is known of the stress",)

    def stress(self, load: LoadRecord) -> HeldStress:
        """Stress through the hold of one press.

        Samples at the cell's limit are left out; a hold whose second half has any, or most of whose samples are
        there, tells nothing of the relaxed stress.
        """
        nothing = np.zeros(0)
        if self.samples is None:
            return HeldStress(nothing, nothing)
        taken = self.samples.between(load.hold_start_s, load.release_start_s)
        if len(taken) < _FEWEST:
            return HeldStress(nothing, nothing, "holds without force samples tell nothing of the stress")
        good = np.ones(len(taken), dtype=np.bool_) if self.limit_N is None else taken.values < self.limit_N
        if good.sum() < max(_FEWEST, len(taken) // 2) or not good[len(taken) // 2 :].all():
            why = (
                f"the load cell is flat at its limit of {self.limit_N:.4g} N: the stress at"
                f" {100 * load.load.strain:g} % strain is not known"
            )
            return HeldStress(nothing, nothing, why)
        groups = np.array_split(np.flatnonzero(good), min(_POINTS, int(good.sum())))
        time_s = np.array([taken.time_s[group].mean() for group in groups]) - load.hold_start_s
        force_N = np.array([taken.values[group].mean() for group in groups])
        return HeldStress(time_s, force_N / self.area_mm2 * 1e3)


def strip_force(phase: PhaseRecord, area_mm2: float) -> StripForce:
    """Force of a phase, and whether its load cell was flat at a limit."""
    samples = phase.channel("force")
    return StripForce(samples, area_mm2, None if samples is None else _limit_N(samples, phase.loads))


def _limit_N(samples: SampleBlock, loads: tuple[LoadRecord, ...]) -> float | None:
    """Highest force, where many samples in a row read exactly that while the others are not as still.

    Without noise a held force is flat too: it is then a limit only if holds of several strains end there.
    """
    if not len(samples):
        return None
    highest = float(samples.values.max())
    at_limit = samples.values == highest
    if highest <= 0 or _longest_run(at_limit) < _FLAT:
        return None
    others = samples.values[~at_limit]
    still = len(others) > 1 and float((np.diff(others) == 0).mean()) > 0.5
    strains = {
        load.load.strain
        for load in loads
        if (samples.between(load.hold_start_s, load.release_start_s).values == highest).any()
    }
    return highest if not still or len(strains) > 1 else None


def _longest_run(flags: NDArray[np.bool_]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max(initial=0))
