"""Whether two relaxations of one material are equivalent: 1D and 2D, blob and whole image."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from cbsr_qa.calibrate.common_relaxation import CommonRelaxation, common_settling_time
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.relaxation import FitStatus

Array = NDArray[np.float64]

#: Times at which shapes are compared.
_TIMES: Final = 121
_CURVES: Final = (FitStatus.ONE, FitStatus.TWO, FitStatus.FLAT)


class Agreement(StrEnum):
    """What two relaxations are to each other."""

    EQUIVALENT = "equivalent"  #: any difference beyond the margin is ruled out
    DIFFERENT = "different"  #: a difference within the margin is ruled out
    UNDECIDED = "undecided"  #: the data rule out neither


@dataclass(frozen=True, slots=True)
class MeasuredRelaxation:
    """A relaxation to compare.

    Parameters
    ----------
    common : fit of one trace or of several together.
    window_s : how long the traces were observed.
    loaded_change : mean change under load of unloadings; None for loadings.
    start_s : where the traces begin: before, shapes are not compared and nothing counts as settled.
    """

    common: CommonRelaxation
    window_s: float
    loaded_change: float | None = None
    start_s: float = 0.0

    @property
    def scale(self) -> float:
        """What shapes are relative to: the steady or the released change."""
        return self.common.fit.offset if self.loaded_change is None else self.loaded_change


@dataclass(frozen=True, slots=True)
class RelaxationAgreement:
    """How far the second relaxation is from the first.

    Parameters
    ----------
    shape : whether the curves, relative to the steady (or released) change, are equivalent.
    shape_difference, shape_stderr, at_s : second less first where that is furthest from zero over its reach.
    shape_reach : no time of the window has a larger difference, at the level asked for.
    time : whether the settling times are.
    time_ratio, time_ratio_stderr : second over first; None where one has no plain number.
    why : in words, where there is no comparison.
    """

    shape: Agreement
    shape_difference: float | None
    shape_stderr: float | None
    at_s: float | None
    shape_reach: float | None
    time: Agreement
    time_ratio: float | None
    time_ratio_stderr: float | None
    why: str = ""


def compare_relaxations(
    first: MeasuredRelaxation,
    second: MeasuredRelaxation,
    *,
    shape_margin: float = 0.1,
    time_margin: float = 0.2,
    level: float = 0.05,
    tolerance: float = 0.15,
) -> RelaxationAgreement:
    """Test two relaxations for equivalence: not "no significant difference", which noise gives as well.

    Two one-sided tests (Schuirmann 1987): equivalent at ``level`` if the interval of level 1 − 2 ``level`` lies
    within the margin. Shapes must do so at each time of the common window (intersection–union, Berger & Hsu 1996: no
    correction is needed). They differ if somewhere the interval of level 1 − ``level``, corrected for the number of
    times (Bonferroni), lies beyond the margin. Everything else is undecided.

    The two count as independent. Traces of the same frames share noise, which then cancels in part: the stated errors
    are too large for them, and equivalence is claimed too rarely, not too often.

    Parameters
    ----------
    shape_margin : largest difference of no consequence, as a share of the steady (or released) change.
    time_margin : largest of settling times, as a share: ratios from 1/(1 + margin) to 1 + margin.
    level : chance of calling two relaxations equivalent that are a margin apart.
    tolerance : of the settling time.

    Raises
    ------
    NumericsError
        If a margin or the level makes no sense.
    """
    if not (shape_margin > 0 and time_margin > 0 and 0 < level < 0.5):
        raise NumericsError(f"margins of {shape_margin:g} and {time_margin:g} at a level of {level:g} decide nothing")
    why = _why_not(first, "first") or _why_not(second, "second")
    if why:
        undecided = Agreement.UNDECIDED
        return RelaxationAgreement(undecided, None, None, None, None, undecided, None, None, why)
    ratio, ratio_stderr, time = _times(first, second, time_margin, level, tolerance)
    time_s = np.linspace(max(first.start_s, second.start_s), min(first.window_s, second.window_s), _TIMES)
    (one, variance), (other, more) = (_relative(measured, time_s) for measured in (first, second))
    difference, stderr = other - one, np.sqrt(variance + more)
    reach = np.abs(difference) + norm.ppf(1 - level) * stderr
    surely = np.abs(difference) - norm.ppf(1 - level / 2 / _TIMES) * stderr
    worst = int(np.argmax(reach))
    return RelaxationAgreement(
        _decided(bool(reach[worst] <= shape_margin), bool(surely.max() > shape_margin)),
        float(difference[worst]),
        float(stderr[worst]),
        float(time_s[worst]),
        float(reach[worst]),
        time,
        ratio,
        ratio_stderr,
    )


def _times(
    first: MeasuredRelaxation, second: MeasuredRelaxation, margin: float, level: float, tolerance: float
) -> tuple[float | None, float | None, Agreement]:
    """Ratio of the settling times, its standard error, and what follows."""
    settled = [
        common_settling_time(one.common, window_s=one.window_s, tolerance=tolerance, loaded_change=one.loaded_change)
        for one in (first, second)
    ]
    plain = [(found.value_s, stderr) for found, stderr in settled if found.value_s and not found.censored and stderr]
    if len(plain) < 2:
        return None, None, Agreement.UNDECIDED
    (one_s, one_stderr), (other_s, other_stderr) = plain
    log_ratio = float(np.log(other_s / one_s))
    log_stderr = float(np.hypot(one_stderr / one_s, other_stderr / other_s))
    limit = float(np.log1p(margin))
    agreement = _decided(
        abs(log_ratio) + float(norm.ppf(1 - level)) * log_stderr <= limit,
        abs(log_ratio) - float(norm.ppf(1 - level / 2)) * log_stderr > limit,
    )
    return other_s / one_s, other_s / one_s * log_stderr, agreement


def _relative(measured: MeasuredRelaxation, time_s: Array) -> tuple[Array, Array]:
    """The fitted curve over its scale, and its variance."""
    common, fit, scale = measured.common, measured.common.fit, measured.scale
    tau = np.array(fit.time_constants_s).reshape(1, -1)
    amplitudes = np.array(fit.amplitudes)
    each = np.exp(-time_s[:, None] / tau)
    moving = each @ amplitudes
    curve = (fit.offset + moving) / scale
    if not len(amplitudes):
        return curve, np.full(
            len(time_s), 0.0 if measured.loaded_change is None else (fit.offset_stderr / scale) ** 2
        )
    by_offset = -moving / scale if measured.loaded_change is None else np.ones_like(moving)
    gradient = np.column_stack([by_offset, each, each * amplitudes * time_s[:, None] / tau]) / scale
    return curve, np.einsum("ti,ij,tj->t", gradient, common.covariance, gradient)


def _why_not(measured: MeasuredRelaxation, which: str) -> str:
    fit = measured.common.fit
    if fit.status not in _CURVES:
        return f"the {which} relaxation has no curve: {fit.why}"
    if not abs(measured.scale) > 3 * fit.offset_stderr:
        return f"the {which} relaxation has no change that is clear of zero"
    return ""


def _decided(within: bool, beyond: bool) -> Agreement:
    if within:
        return Agreement.EQUIVALENT
    return Agreement.DIFFERENT if beyond else Agreement.UNDECIDED
