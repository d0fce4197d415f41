"""Hard cases of relaxation fits: time constants that are close, lost, too slow or in other units."""

from typing import Any, Final

import mpmath
import numpy as np

from cbsr_qa.calibration.fits.common_relaxation import fit_common_relaxation
from cbsr_qa.calibration.fits.relaxation import fit_relaxation
from cbsr_qa.calibration.fits.settling import estimate_restricted_mean, settling_time
from cbsr_qa.calibration.fits.steady_state import predict_steady
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.relaxation import FitStatus, RelaxationFit, RelaxationKernel
from cbsr_qa.studies.hard_cases.case import EPSILON, Answer, Area, answer_from_condition, condition_bound
from cbsr_qa.studies.hard_cases.exact import DIGITS, largest_relative_error, relative_error

AREA: Final = Area("relaxation")
_PARAMETERS: Final = "the parameters the trace was made from"
_ROOT: Final = "root of the same curve in fifty digits"
_TIME_S: Final[Array] = 2.5 * np.arange(25.0)  # a minute at the rig's frame rate
_WINDOW_S: Final = 60.0


def curve(offset: float, amplitudes: tuple[float, ...], taus_s: tuple[float, ...], time_s: Array = _TIME_S) -> Array:
    """G(t) = a₀ + Σ a e^(−t/τ), (n,)."""
    values: Array = offset + np.exp(-time_s[:, None] / np.array(taus_s)) @ np.array(amplitudes)
    return values


def fit_condition(offset: float, amplitudes: tuple[float, ...], taus_s: tuple[float, ...]) -> float:
    """Largest relative change of a parameter per relative change of the values, of the linearised problem."""
    decays = np.exp(-_TIME_S[:, None] / np.array(taus_s))
    design = np.column_stack(
        [np.ones_like(_TIME_S), decays, decays * _TIME_S[:, None] / np.array(taus_s) * amplitudes]
    )
    size = np.abs([offset, *amplitudes, *np.ones(len(taus_s))])
    rows = np.linalg.norm(np.linalg.pinv(design), axis=1) / size
    return float(rows.max() * np.linalg.norm(curve(offset, amplitudes, taus_s)))


def fit_known_curve(
    offset: float,
    amplitudes: tuple[float, ...],
    taus_s: tuple[float, ...],
    *,
    unit: float = 1.0,
    second: float = 1.0,
    single: bool = False,
) -> Answer:
    """Largest relative error of offset, amplitudes and time constants of a fit of exact values.

    Parameters
    ----------
    unit, second : factor of the values, and units of time in a second.
    single : whether the values are rounded to single precision first.
    """
    values = curve(offset, amplitudes, taus_s)
    scaled = (values * unit).astype(np.float32) if single else values * unit
    fit = fit_relaxation(_TIME_S * second, np.asarray(scaled))
    computed = [fit.offset / unit, *np.array(fit.amplitudes) / unit, *np.array(fit.time_constants_s) / second]
    truth = [offset, *amplitudes, *taus_s]
    error = largest_relative_error(computed, truth) if len(computed) == len(truth) else 1.0
    condition = fit_condition(offset, amplitudes, taus_s)
    rounding = float(np.finfo(np.float32).eps) / EPSILON if single else 1.0
    return Answer(error, condition_bound(condition * rounding), condition, note=str(fit.status))


def settle_known_curve(amplitudes: tuple[float, float], taus_s: tuple[float, float]) -> Answer:
    """Settling time of a known curve, against the root of the same curve in fifty digits."""
    fit = RelaxationFit(FitStatus.TWO, 1.0, amplitudes, taus_s, 0.0, (0.0, 0.0), 1.0, "")
    settled_s = settling_time(fit, window_s=_WINDOW_S).value_s or 0.0
    with mpmath.workdps(DIGITS):

        def beyond(time_s: Any) -> Any:
            deviation = sum(
                mpmath.mpf(a) * mpmath.exp(-time_s / mpmath.mpf(tau))
                for a, tau in zip(amplitudes, taus_s, strict=True)
            )
            return abs(deviation) - mpmath.mpf(0.15)

        # The last crossing: looked for from the end of the window, and not from where it was found.
        late = next(k for k in range(int(4 * _WINDOW_S), 0, -1) if beyond(mpmath.mpf(k - 1) / 4) > 0)
        truth = mpmath.findroot(beyond, (mpmath.mpf(late - 1) / 4, mpmath.mpf(late) / 4), solver="anderson")
        slope = abs(mpmath.diff(beyond, truth))
        of_parts = sum(
            abs(a) * mpmath.exp(-truth / tau) * (1 + truth / tau) for a, tau in zip(amplitudes, taus_s, strict=True)
        )
        condition = float(of_parts / (slope * truth))
    return answer_from_condition(relative_error(settled_s, truth), condition)


def steady_without_noise(noise: float) -> Answer:
    """Steady state predicted from the frames of a hold whose noise is this share of it."""
    taus_s, weights = np.array([5.0, 30.0]), np.array([0.3, 0.2])
    kernel = RelaxationKernel(True, weights, taus_s, np.eye(4) * 1e-4, 0.1 * weights, 8.0, 9)
    time_s: Array = 2.5 * np.arange(1.0, 25.0)
    steady = predict_steady(time_s, curve(1.0, (0.3, 0.2), (5.0, 30.0), time_s), noise, kernel)
    decays = np.exp(-time_s[:, None] / taus_s)
    design = np.column_stack(
        [1 + decays @ weights, 0.01 * decays, 0.01 * weights * decays * time_s[:, None] / taus_s]
    )
    condition = float(np.linalg.norm(np.linalg.pinv(design)[0]) * np.linalg.norm(design[:, 0]))
    return answer_from_condition(relative_error(float(steady.values[0]), _mp(1)), condition)


def _mp(value: float | str) -> Any:
    with mpmath.workdps(DIGITS):
        return mpmath.mpf(value)


@AREA.against(_PARAMETERS)
def time_constants_a_factor_apart() -> Answer:
    """Two exponentials of 8 and 20 s in 25 frames look like one: their sum hardly says how it is shared."""
    return fit_known_curve(1.0, (0.3, 0.2), (8.0, 20.0))


@AREA.against(_PARAMETERS)
def small_exponential_beside_a_large_one() -> Answer:
    """An exponential of a two-thousandth of the other's size has to be found beside it."""
    return fit_known_curve(1.0, (1e-4, 0.2), (5.0, 30.0))


@AREA.against(_PARAMETERS)
def zero_amplitude() -> Answer:
    """An absent second exponential leaves its time constant undetermined."""
    return fit_known_curve(1.0, (0.3,), (9.0,))


@AREA.against(_PARAMETERS)
def non_monotone_relaxation() -> Answer:
    """Two exponentials of opposite signs overshoot."""
    return fit_known_curve(1.0, (-0.3, 0.2), (5.0, 30.0))


@AREA.against(_PARAMETERS)
def relaxation_on_an_offset_of_1e6() -> Answer:
    """A relaxation that is a millionth of the level it happens on: six digits are gone before the fit begins."""
    return fit_known_curve(1e6, (0.3, 0.2), (5.0, 30.0))


@AREA.against(_PARAMETERS)
def values_of_1e_9() -> Answer:
    """A trace in a unit that makes its numbers tiny: absolute tolerances would call it flat."""
    return fit_known_curve(1.0, (0.3, 0.2), (5.0, 30.0), unit=1e-9)


@AREA.against(_PARAMETERS)
def values_of_1e9() -> Answer:
    """A trace in a unit that makes its numbers huge."""
    return fit_known_curve(1.0, (0.3, 0.2), (5.0, 30.0), unit=1e9)


@AREA.against(_PARAMETERS)
def times_in_milliseconds() -> Answer:
    """A time axis in milliseconds: time constants of thousands."""
    return fit_known_curve(1.0, (0.3, 0.2), (5.0, 30.0), second=1e3)


@AREA.against(_PARAMETERS)
def single_precision_trace() -> Answer:
    """A trace of 24-bit numbers; the bound is condition number times single-precision rounding."""
    return fit_known_curve(1.0, (0.3, 0.2), (5.0, 30.0), single=True)


@AREA.against("the exponential of their mean, settled where 0.5 e^(−t/τ) = 0.15")
def time_constants_alike() -> Answer:
    """Two time constants that differ by 1e-8 make the exponentials linearly dependent."""
    taus_s = (20.0, 20.0 * (1 + 1e-8))
    fit = fit_relaxation(_TIME_S, curve(1.0, (0.3, 0.2), taus_s))
    settled = settling_time(fit, window_s=_WINDOW_S).value_s
    # Both exponentials are that of the mean time constant to 1e-17.
    truth = _mp(20) * (1 + _mp("0.4e-8")) * mpmath.log(_mp(1) / _mp("0.3"))
    condition = fit_condition(1.0, (0.5,), (20.0,))
    error = max(relative_error(fit.offset, _mp(1)), relative_error(settled or 0.0, truth))
    return answer_from_condition(error, condition, note=fit.why)


@AREA.against("it settles later than the trace")
def trace_shorter_than_its_time_constant() -> Answer:
    """One minute of a 1000 s exponential is a straight line that does not show its end."""
    fit = fit_relaxation(_TIME_S, curve(1.0, (0.2,), (1000.0,)))
    settled = settling_time(fit, window_s=_WINDOW_S)
    wrong_count = 0.0 if fit.status is FitStatus.DRIFTING and settled.censored else 1.0
    return Answer(wrong_count, 0.0, unit="wrong statements", note=settled.why)


@AREA.against("that level, settled at once")
def constant_trace() -> Answer:
    """A trace without any variance to explain, at a level that rounds."""
    fit = fit_relaxation(_TIME_S, np.full(len(_TIME_S), 0.1))
    flat = fit.status is FitStatus.FLAT and settling_time(fit, window_s=_WINDOW_S).value_s == 0.0
    return answer_from_condition(relative_error(fit.offset, _mp(0.1)) + (not flat), 1.0)


@AREA.against(_ROOT)
def settling_of_equal_time_constants() -> Answer:
    """Opposite exponentials with the same time constant: where they cancel is a division by zero."""
    return settle_known_curve((1.0, -0.5), (20.0, 20.0))


@AREA.against(_ROOT)
def settling_of_cancelling_exponentials() -> Answer:
    """Amplitudes of ±400 000 whose time constants differ by a millionth leave a curve of size 1."""
    return settle_known_curve((-4e5, 4e5 + 0.5), (20.0, 20.0 * (1 + 1e-6)))


@AREA.against("it settles later than the trace")
def never_settled() -> Answer:
    """A curve that is outside its band at the end of the trace."""
    fit = RelaxationFit(FitStatus.TWO, 1.0, (1.0, 0.5), (1.0, 2000.0), 0.0, (0.0, 0.0), 1.0, "")
    settling = settling_time(fit, window_s=_WINDOW_S)
    return Answer(
        0.0 if settling.censored and settling.value_s == _WINDOW_S else 1.0,
        0.0,
        unit="wrong statements",
        note=settling.why,
    )


@AREA.against("the same deviation in fifty digits")
def settling_times_that_agree() -> Answer:
    """The deviation of times that agree to 1e-8 is a small difference of large squares."""
    times = [30.0, 30.0 + 3e-7, 30.0 - 3e-7, 30.0 + 1e-7]
    _, deviation = estimate_restricted_mean(times, [False] * 4)
    with mpmath.workdps(DIGITS):
        exact = [mpmath.mpf(time) for time in times]
        mean = mpmath.fsum(exact) / 4
        truth = mpmath.sqrt(mpmath.fsum((time - mean) ** 2 for time in exact) / 4)
    condition = 30.0 / float(truth)
    return answer_from_condition(relative_error(deviation, truth), condition)


@AREA.against("the parameters the traces were made from")
def loads_of_sizes_a_million_apart() -> Answer:
    """Loads that share their time constants, but one is a million times as large as another."""
    sizes = (1e-3, 1.0, 1e3)
    common = fit_common_relaxation([(_TIME_S, size * curve(1.0, (0.3, 0.2), (5.0, 30.0))) for size in sizes])
    computed = [*common.fit.time_constants_s, *(common.scales / (0.5 * np.array(sizes)))]
    error = largest_relative_error(computed, [5, 30, 1, 1, 1]) if len(computed) == 5 else 1.0
    condition = fit_condition(1.0, (0.3, 0.2), (5.0, 30.0))
    return answer_from_condition(error, condition)


@AREA.against("the steady state of the curve, which the kernel describes exactly")
def steady_state_without_noise() -> Answer:
    """Frames with a noise of 1e-12 beside a prior of 10 %: weights 1e22 apart in one system of equations."""
    return steady_without_noise(1e-12)


@AREA.refuses(NumericsError)
def epoch_times() -> None:
    """A time axis in seconds since 1970 leaves nothing of any exponential from the end of the ramp."""
    fit_relaxation(_TIME_S + 1.7e9, curve(1.0, (0.3, 0.2), (5.0, 30.0)))


@AREA.refuses(NumericsError)
def values_whose_squares_underflow() -> None:
    """Sums of squares of values of 1e-200 are zero."""
    fit_relaxation(_TIME_S, 1e-200 * curve(1.0, (0.3, 0.2), (5.0, 30.0)))


@AREA.refuses(NumericsError)
def trace_with_nan() -> None:
    """A NaN spoils every sum it is in."""
    fit_relaxation(_TIME_S, np.where(_TIME_S == 10, np.nan, 1.0))
