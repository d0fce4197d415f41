"""Conformity of one measured error with its maximum, and the specific risks of that decision (JCGM 106:2012).

The true error η, given the measured one e with standard uncertainty u of ν degrees of freedom, is distributed as
e + u t_ν (JCGM 100, G.3). With the tolerance interval [−T, T] the conformance probability is p_c = P(−T ≤ η ≤ T)
(7.5); an accepted item does not conform with the probability 1 − p_c, and a rejected one conforms with p_c (9.3.2).
"""

from dataclasses import dataclass
from enum import StrEnum
from math import inf, isfinite

from scipy import special


class Conformity(StrEnum):
    """Decision about one error, from best to worst; words as in a digital calibration certificate."""

    PASS = "pass"  #: |e| ≤ T − w: accepted, outside of the guard band
    CONDITIONAL_PASS = "conditionalPass"  #: |e| ≤ T, inside the guard band: neither accepted nor rejected
    CONDITIONAL_FAIL = "conditionalFail"  #: |e| ≤ T + w, outside of the tolerance: neither
    FAIL = "fail"  #: |e| > T + w: rejected


@dataclass(frozen=True, slots=True)
class Decision:
    """Decision about one measured error.

    Parameters
    ----------
    outcome : what was decided.
    conformance : probability that the true error is within its maximum.
    """

    outcome: Conformity
    conformance: float


def decide_error(error: float, maximum: float, guard: float, uncertainty: float, dof: float = inf) -> Decision:
    """Decide whether an error is within its maximum.

    Parameters
    ----------
    error, maximum : e and T > 0, in one unit.
    guard : width w ≥ 0 of the guard band on both sides of the limit (8.3.2); 0 for simple acceptance (8.2).
    uncertainty, dof : standard uncertainty u > 0 of e, and its degrees of freedom ν ≥ 1.
    """
    size = abs(error)
    if size <= maximum - guard:
        outcome = Conformity.PASS
    elif size <= maximum:
        outcome = Conformity.CONDITIONAL_PASS
    else:
        outcome = Conformity.CONDITIONAL_FAIL if size <= maximum + guard else Conformity.FAIL
    return Decision(outcome, conformance_probability(error, maximum, uncertainty, dof))


def conformance_probability(error: float, maximum: float, uncertainty: float, dof: float = inf) -> float:
    """Return p_c, the probability that the true error is within its maximum; see :func:`decide_error`."""
    ends = ((maximum - error) / uncertainty, (-maximum - error) / uncertainty)
    upper, lower = (special.stdtr(dof, end) if isfinite(dof) else special.ndtr(end) for end in ends)
    return float(upper - lower)
