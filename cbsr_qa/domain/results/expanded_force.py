"""Forces and places with expanded uncertainties, and the budgets that they come from (JCGM 100, 6 and 7)."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from math import hypot
from typing import Final

#: Input of a sensor in use: its readings' gains since the reference frame.
GAIN_DRIFT: Final = "drift of gains since the reference"


class Result(StrEnum):
    """What an uncertainty is stated of; docs/explanation/uncertainty.md says which inputs belong to each."""

    ON_THE_DAY = "on the day"  #: a force that the sensor indicates on the day of calibration
    IN_USE = "in use"  #: a force that it indicates later, until the end of its validity
    ERROR = "error"  #: indicated less reference force of one press, as the sensor's error there


@dataclass(frozen=True, slots=True)
class BudgetComponent:
    """One input of a budget.

    Parameters
    ----------
    name : input, e.g. ``"load cell"``.
    kind : ``"A"`` if it was evaluated by statistics of observations, ``"B"`` otherwise (JCGM 100, 3.3.4).
    contribution : c u(x), sensitivity times standard uncertainty, in the measurand's unit; its sign counts where
        shared inputs of several results are combined.
    dof : degrees of freedom of u(x); infinite if it is taken as known.
    share : share of the combined variance.
    source : where the number is from.
    shared : whether all results of the calibration have the same error of this input.
    """

    name: str
    kind: str
    contribution: float
    dof: float
    share: float
    source: str
    shared: bool = False

    @property
    def standard_uncertainty(self) -> float:
        """|c| u(x), in the measurand's unit."""
        return abs(self.contribution)


@dataclass(frozen=True, slots=True)
class MonteCarlo:
    """Distribution of a result by propagated random numbers (JCGM 101).

    Parameters
    ----------
    trials : number of trials.
    low, high : interval of 95 % with equal tails (JCGM 101, 7.7), in the measurand's unit.
    why : why the law of propagation alone may not be enough.
    """

    trials: int
    low: float
    high: float
    why: str

    @property
    def half_width(self) -> float:
        """Half of the interval, to compare with U."""
        return (self.high - self.low) / 2


@dataclass(frozen=True, slots=True)
class Budget:
    """Combined and expanded uncertainty of a result, in the measurand's unit.

    Parameters
    ----------
    standard_uncertainty : combined standard uncertainty u_c (JCGM 100, 5.1.2).
    dof : effective degrees of freedom (JCGM 100, G.4.1), not truncated; infinite if every input's are.
    k : coverage factor of 95 %: Student's t of ``dof`` truncated (JCGM 100, G.4.1 and G.6.4).
    components : inputs in the sum, by falling share.
    not_stated : inputs that nothing gives a number for; they are not in the sum.
    """

    standard_uncertainty: float
    dof: float
    k: float
    components: tuple[BudgetComponent, ...]
    not_stated: tuple[str, ...] = ()

    @property
    def expanded(self) -> float:
        """U = k u_c."""
        return self.k * self.standard_uncertainty

    @property
    def shared_uncertainty(self) -> float:
        """Combined standard uncertainty of the shared inputs, which does not average out."""
        return hypot(*(component.contribution for component in self.components if component.shared))


@dataclass(frozen=True, slots=True)
class ExpandedForce:
    """A force of one settled load at a stated place, or the error of one, with the expanded uncertainty for 95 %.

    Parameters
    ----------
    place_mm : (x, y) from the sheet's centre.
    force_N : stated force; of an error, the reference force.
    settling_s : time after the press's ramp for which it is stated.
    budget : uncertainty [N].
    monte_carlo : distribution by random numbers where the law of propagation may not do; None where it does.
    """

    place_mm: tuple[float, float]
    force_N: float
    settling_s: float
    budget: Budget
    monte_carlo: MonteCarlo | None = None

    @property
    def standard_uncertainty_N(self) -> float:
        """Combined standard uncertainty."""
        return self.budget.standard_uncertainty

    @property
    def U_N(self) -> float:
        """Expanded uncertainty; half of the interval by random numbers where that is wider (JCGM 101, 8)."""
        return (
            self.budget.expanded
            if self.monte_carlo is None
            else max(self.budget.expanded, self.monte_carlo.half_width)
        )

    @property
    def k(self) -> float:
        """Coverage factor: U over the combined standard uncertainty."""
        u_N = self.budget.standard_uncertainty
        return self.U_N / u_N if u_N else self.budget.k

    @property
    def dof(self) -> float:
        """Effective degrees of freedom; infinite if every input's are."""
        return self.budget.dof

    @property
    def components(self) -> tuple[BudgetComponent, ...]:
        """Inputs in the sum."""
        return self.budget.components

    @property
    def not_stated(self) -> tuple[str, ...]:
        """Inputs that nothing gives a number for."""
        return self.budget.not_stated


def list_missing(forces: Iterable[ExpandedForce]) -> list[str]:
    """Return what U lacks, since nothing gives a number for it."""
    return list(dict.fromkeys(name for force in forces for name in force.not_stated))


@dataclass(frozen=True, slots=True)
class ExpandedPlace:
    """A place that one frame tells of a load, with the radius of the circle that holds it with 95 %.

    Parameters
    ----------
    place_mm : (x, y) from the sheet's centre.
    force_N : force of the load.
    budget : uncertainty along an axis, root mean square over both [mm]; ``k`` turns it into the radius.
    """

    place_mm: tuple[float, float]
    force_N: float
    budget: Budget

    @property
    def U_mm(self) -> float:
        """Radius of the circle."""
        return self.budget.expanded


@dataclass(frozen=True, slots=True)
class ExpandedSettling:
    """A mean settling time of a calibration's loads.

    Parameters
    ----------
    signal, loading : as in :class:`~cbsr_qa.domain.results.calibration.SettlingSummary`.
    mean_s : mean over the loads.
    budget : uncertainty of the mean [s].
    """

    signal: str
    loading: bool
    mean_s: float
    budget: Budget

    @property
    def U_s(self) -> float:
        """Expanded uncertainty."""
        return self.budget.expanded
