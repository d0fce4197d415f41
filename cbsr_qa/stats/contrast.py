"""An estimated difference with its standard error: interval, p value, and whether it is small enough not to matter.

Two one-sided tests (Schuirmann 1987) call a difference Δ equivalent to none where both Δ ≤ −m and Δ ≥ m are refuted
at level α, which is the same as the 1 − 2α interval lying within ± m.
"""

from dataclasses import dataclass
from math import inf, isfinite

from scipy import stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.samples import Interval, share


@dataclass(frozen=True, slots=True)
class Equivalence:
    """Result of two one-sided tests.

    Parameters
    ----------
    margin : m, in the difference's unit.
    p_value : the larger of both tests'.
    interval : of 1 − 2α.
    equivalent : whether p ≤ α.
    """

    margin: float
    p_value: float
    interval: Interval
    equivalent: bool


@dataclass(frozen=True, slots=True)
class Contrast:
    """An estimate that is t-distributed about its true value in units of its standard error.

    Parameters
    ----------
    value, standard_error : in the same unit; the error is above 0.
    freedom : degrees of freedom, above 0, need not be whole.
    """

    value: float
    standard_error: float
    freedom: float

    def statistic(self, null: float = 0.0) -> float:
        """Return t of the hypothesis that the true value is ``null``."""
        return (self.value - null) / self.standard_error

    def p_value(self, null: float = 0.0) -> float:
        """Return the two-sided p value of the hypothesis that the true value is ``null``."""
        return float(2 * stats.t.sf(abs(self.statistic(null)), self.freedom))

    def interval(self, confidence: float = 0.95) -> Interval:
        """Return value ± t × standard error."""
        share(confidence, "confidence")
        half = float(stats.t.isf((1 - confidence) / 2, self.freedom)) * self.standard_error
        return Interval(self.value - half, self.value + half, confidence)

    def equivalence(self, margin: float, *, level: float = 0.05) -> Equivalence:
        """Test whether the true value lies within ± ``margin``.

        Raises
        ------
        NumericsError
            The margin is not a positive number, or the level is none.
        """
        if not (margin > 0 and isfinite(margin)):
            raise NumericsError(f"equivalence: a margin of {margin:g} is none; allowed are positive numbers")
        if not 0 < level < 0.5:
            raise NumericsError(f"equivalence: level is {level:g}; allowed are numbers between 0 and 0.5")
        worst = max(
            float(stats.t.sf(self.statistic(-margin), self.freedom)),
            float(stats.t.cdf(self.statistic(margin), self.freedom)),
        )
        return Equivalence(margin, worst, self.interval(1 - 2 * level), worst <= level)


def checked(value: float, standard_error: float, freedom: float, what: str) -> Contrast:
    """Return a contrast; refuse one whose numbers say nothing.

    Raises
    ------
    NumericsError
        The standard error is zero or no number, or there are no degrees of freedom.
    """
    if not (isfinite(value) and 0 < standard_error < inf and freedom > 0):
        raise NumericsError(
            f"{what}: {value:g} with a standard error of {standard_error:g} on {freedom:g} degrees of freedom "
            "cannot be judged"
        )
    return Contrast(value, standard_error, freedom)
