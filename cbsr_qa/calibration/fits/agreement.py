"""Whether two relaxations of one material are equivalent: 1D and 2D, blob and whole image."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Protocol

import numpy as np
from scipy.special import ndtri

from cbsr_qa.calibration.fits.common_relaxation import CommonRelaxation, common_settling_time
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.relaxation import FitStatus

#: Negligible differences: of the shape, as a share of the change, and of the settling time, as a share.
SHAPE_MARGIN: Final = 0.1
TIME_MARGIN: Final = 0.2
#: Probability of calling two relaxations equivalent that differ by the margin.
LEVEL: Final = 0.05
#: Times at which shapes are compared.
_TIMES: Final = 121
_CURVES: Final = (FitStatus.ONE, FitStatus.TWO, FitStatus.FLAT)


class Agreement(StrEnum):
    """Relation of two relaxations."""

    EQUIVALENT = "equivalent"  #: any difference beyond the margin is ruled out
    DIFFERENT = "different"  #: a difference within the margin is ruled out
    UNDECIDED = "undecided"  #: the data rule out neither


class ComparableRelaxation(Protocol):
    """A curve relative to its change, from ``start_s`` to ``window_s``."""

    @property
    def start_s(self) -> float:
        """Start: earlier, shapes are not compared and nothing counts as settled."""

    @property
    def window_s(self) -> float:
        """End of the known part."""

    @property
    def why_not(self) -> str:
        """Why it cannot be compared; empty otherwise."""

    def relative(self, time_s: Array) -> tuple[Array, Array]:
        """Return the curve over the steady (or released) change, and its variance, (n,) each."""

    def settling_time(self, tolerance: float) -> tuple[float, float] | None:
        """Return the settling time and its standard error [s]; None without a plain number."""


@dataclass(frozen=True, slots=True)
class MeasuredRelaxation:
    """A relaxation to compare.

    Parameters
    ----------
    common : fit of one trace or of several together.
    window_s : time for which the traces were observed.
    loaded_change : mean change under load of unloadings; None for loadings.
    start_s : start of the traces: earlier, shapes are not compared and nothing counts as settled.
    """

    common: CommonRelaxation
    window_s: float
    loaded_change: float | None = None
    start_s: float = 0.0

    @property
    def scale(self) -> float:
        """Scale of shapes: the steady or the released change."""
        return self.common.fit.offset if self.loaded_change is None else self.loaded_change

    @property
    def why_not(self) -> str:
        """Why it cannot be compared; empty otherwise."""
        fit = self.common.fit
        if fit.status not in _CURVES:
            return f"has no curve: {fit.why}"
        return "" if abs(self.scale) > 3 * fit.offset_stderr else "has no change that is clear of zero"

    def relative(self, time_s: Array) -> tuple[Array, Array]:
        """Return the fitted curve over its scale, and its variance."""
        common, fit, scale = self.common, self.common.fit, self.scale
        tau = np.array(fit.time_constants_s).reshape(1, -1)
        amplitudes = np.array(fit.amplitudes)
        decays = np.exp(-time_s[:, None] / tau)
        decaying_part = decays @ amplitudes
        curve = (fit.offset + decaying_part) / scale
        if not len(amplitudes):
            variance = 0.0 if self.loaded_change is None else (fit.offset_stderr / scale) ** 2
            return curve, np.full(len(time_s), variance)
        by_offset = -decaying_part / scale if self.loaded_change is None else np.ones_like(decaying_part)
        gradient = np.column_stack([by_offset, decays, decays * amplitudes * time_s[:, None] / tau]) / scale
        return curve, np.einsum("ti,ij,tj->t", gradient, common.covariance, gradient)

    def settling_time(self, tolerance: float) -> tuple[float, float] | None:
        """Return the settling time of the mean trace and its standard error [s]; None without a plain number."""
        settling, stderr = common_settling_time(
            self.common, window_s=self.window_s, tolerance=tolerance, loaded_change=self.loaded_change
        )
        return (settling.value_s, stderr) if settling.value_s and not settling.censored and stderr else None


@dataclass(frozen=True, slots=True, eq=False)
class ComparedCurves:
    """Two relaxations over their common window, relative to their change, with standard errors.

    Parameters
    ----------
    time_s : (n,) times from the end of the ramp.
    first, first_stderr, second, second_stderr : (n,) curves and their standard errors.
    """

    time_s: Array
    first: Array
    first_stderr: Array
    second: Array
    second_stderr: Array

    @property
    def difference(self) -> Array:
        """Second less first."""
        return self.second - self.first

    @property
    def stderr(self) -> Array:
        """Standard error of the difference, both assumed independent."""
        return np.hypot(self.first_stderr, self.second_stderr)


@dataclass(frozen=True, slots=True, eq=False)
class RelaxationAgreement:
    """Difference of the second relaxation from the first.

    Parameters
    ----------
    shape : verdict on the curves, relative to the steady (or released) change.
    shape_difference, shape_stderr, at_s : second less first curve and its error, at the time when it is largest
        relative to its reach.
    shape_reach : bound of the difference at all times of the window, at the requested level.
    time : verdict on the settling times.
    time_ratio, time_ratio_stderr : second over first; None if one has no plain number.
    time_reach : bound of the ratio, either way, at the requested level; None if one has no plain number.
    curves : compared curves, or None.
    why : reason for a missing comparison.
    """

    shape: Agreement
    shape_difference: float | None
    shape_stderr: float | None
    at_s: float | None
    shape_reach: float | None
    time: Agreement
    time_ratio: float | None
    time_ratio_stderr: float | None
    time_reach: float | None = None
    curves: ComparedCurves | None = None
    why: str = ""


def refuse_comparison(why: str) -> RelaxationAgreement:
    """Return a missing comparison with its reason."""
    undecided = Agreement.UNDECIDED
    return RelaxationAgreement(undecided, None, None, None, None, undecided, None, None, why=why)


def compare_relaxations(
    first: ComparableRelaxation,
    second: ComparableRelaxation,
    *,
    tolerance: float = 0.15,
) -> RelaxationAgreement:
    """Test two relaxations for equivalence, which is stronger than "no significant difference" (as noise gives).

    Two one-sided tests (Schuirmann 1987): equivalent at the level α of 5 % if the interval of level 1 − 2 α lies
    within the margin. Shapes must do so at each time of the common window (intersection–union, Berger & Hsu 1996: no
    correction is needed). They differ if somewhere the interval of level 1 − α, corrected for the number of
    times (Bonferroni), lies beyond the margin. Everything else is undecided.

    Parameters
    ----------
    tolerance : tolerance of the settling time, as a fraction.
    """
    for ordinal, measured in (("first", first), ("second", second)):
        if measured.why_not:
            return refuse_comparison(f"the {ordinal} relaxation {measured.why_not}")
    start_s, end_s = max(first.start_s, second.start_s), min(first.window_s, second.window_s)
    if not start_s < end_s:
        return refuse_comparison(f"no time in common: one begins at {start_s:.3g} s, one ends at {end_s:.3g} s")
    time_s = np.linspace(start_s, end_s, _TIMES)
    (curve, variance), (other, other_variance) = first.relative(time_s), second.relative(time_s)
    curves = ComparedCurves(time_s, curve, np.sqrt(variance), other, np.sqrt(other_variance))
    difference, stderr = curves.difference, curves.stderr
    reach = np.abs(difference) + ndtri(1 - LEVEL) * stderr
    surely = np.abs(difference) - ndtri(1 - LEVEL / 2 / _TIMES) * stderr
    worst = int(np.argmax(reach))
    ratio, ratio_stderr, ratio_reach, time = _times(first, second, tolerance)
    return RelaxationAgreement(
        _decide(bool(reach[worst] <= SHAPE_MARGIN), bool(surely.max() > SHAPE_MARGIN)),
        float(difference[worst]),
        float(stderr[worst]),
        float(curves.time_s[worst]),
        float(reach[worst]),
        time,
        ratio,
        ratio_stderr,
        ratio_reach,
        curves,
    )


def _times(
    first: ComparableRelaxation, second: ComparableRelaxation, tolerance: float
) -> tuple[float | None, float | None, float | None, Agreement]:
    """Ratio of the settling times, its standard error, its bound, and the conclusion."""
    first_time, second_time = first.settling_time(tolerance), second.settling_time(tolerance)
    if first_time is None or second_time is None:
        return None, None, None, Agreement.UNDECIDED
    (one_s, one_stderr), (other_s, other_stderr) = first_time, second_time
    log_ratio = float(np.log(other_s / one_s))
    log_stderr = float(np.hypot(one_stderr / one_s, other_stderr / other_s))
    limit = float(np.log1p(TIME_MARGIN))
    reach = abs(log_ratio) + float(ndtri(1 - LEVEL)) * log_stderr
    agreement = _decide(reach <= limit, abs(log_ratio) - float(ndtri(1 - LEVEL / 2)) * log_stderr > limit)
    return other_s / one_s, other_s / one_s * log_stderr, float(np.exp(min(reach, 50.0))), agreement


def _decide(within: bool, beyond: bool) -> Agreement:
    if within:
        return Agreement.EQUIVALENT
    return Agreement.DIFFERENT if beyond else Agreement.UNDECIDED
