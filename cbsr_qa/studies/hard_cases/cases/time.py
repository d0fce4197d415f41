"""Hard cases of time stamps: repeated, decreasing, far from zero, all equal."""

from typing import Final

import numpy as np

from cbsr_qa.calibration.fits.relaxation import exponentials, fit_relaxation
from cbsr_qa.calibration.fits.relaxation_kernel import learn_kernel
from cbsr_qa.calibration.fits.settling import relaxation_start
from cbsr_qa.calibration.fits.steady_state import predict_steady
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.relaxation import RelaxationKernel
from cbsr_qa.studies.hard_cases.case import Answer, Area, answer_from_condition
from cbsr_qa.studies.hard_cases.exact import largest_relative_error, mean_exponential, relative_error

AREA: Final = Area("time")
_INTEGRALS: Final = "the integrals in fifty digits"
_TIME_S: Final[Array] = 2.5 * np.arange(25.0)
_CURVE: Final[Array] = 1.0 + 0.3 * np.exp(-_TIME_S / 5) + 0.2 * np.exp(-_TIME_S / 30)


def short_ramp(share: float) -> Answer:
    """Exponential after a ramp, averaged over a frame, both this share of its time constant.

    The slope by log τ changes its sign at a share of 4.567, where its terms, of the value's size, cancel.
    """
    tau_s, time_s = 8.0, 3.0
    values, slopes = exponentials(np.array([time_s]), np.array([tau_s]), ramp_s=share * tau_s, frame_s=share * tau_s)
    exact = mean_exponential(time_s, tau_s, share * tau_s, share * tau_s)
    cancelling = float(abs(exact[0] / exact[1]))
    return answer_from_condition(
        largest_relative_error([values[0, 0], slopes[0, 0]], exact), 2.0 * max(1.0, cancelling)
    )


def spike_of(values: Array, expected: int) -> Answer:
    """Where the relaxation begins behind an unloading spike."""
    return Answer(float(abs(relaxation_start(values) - expected)), 0.0, unit="samples")


@AREA.refuses(NumericsError)
def time_stamps_that_repeat() -> None:
    """Two samples with one time stamp: at most one of them is right."""
    fit_relaxation(np.minimum(_TIME_S, 50.0), _CURVE)


@AREA.refuses(NumericsError)
def time_stamps_that_step_back() -> None:
    """A clock that was set back in the middle of a trace."""
    fit_relaxation(np.where(_TIME_S > 30, _TIME_S - 10, _TIME_S), _CURVE)


@AREA.refuses(NumericsError)
def time_stamps_that_round_together() -> None:
    """Frames a nanosecond apart, counted from 1970: a double has no room for them."""
    fit_relaxation(1.7e9 + 1e-9 * _TIME_S, _CURVE)


@AREA.refuses(NumericsError)
def all_at_one_instant() -> None:
    """Loads whose samples all have one time."""
    learn_kernel([(np.full(8, 3.0), np.linspace(1, 2, 8))] * 3)


@AREA.against("the parameters the trace was made from")
def frames_at_irregular_times() -> Answer:
    """Frames from a nanosecond to half a minute apart in one trace."""
    time_s = np.cumsum(10.0 ** np.linspace(-9, 1.5, 30))
    decays = np.exp(-time_s[:, None] / [5.0, 30.0])
    values = 1 + decays @ [0.3, 0.2]
    fit = fit_relaxation(time_s, values)
    design = np.column_stack([np.ones_like(time_s), decays, decays * time_s[:, None] / [5.0, 30.0] * [0.3, 0.2]])
    condition = float(np.linalg.norm(np.linalg.pinv(design)[3:], axis=1).max() * np.linalg.norm(values))
    computed = [*fit.time_constants_s, *fit.amplitudes]
    error = largest_relative_error(computed, [5, 30, 0.3, 0.2]) if len(computed) == 4 else 1.0
    return answer_from_condition(error, condition)


@AREA.against(_INTEGRALS)
def ramp_much_shorter_than_a_time_constant() -> Answer:
    """What ramp and frame do to an exponential are differences of numbers that agree to six digits."""
    return short_ramp(1e-6)


@AREA.against(_INTEGRALS)
def ramp_as_long_as_a_time_constant() -> Answer:
    """The same where a power series would not converge quickly."""
    return short_ramp(1.1)


@AREA.refuses(NumericsError)
def frame_of_a_thousand_time_constants() -> None:
    """The mean of an exponential over a frame is a huge number times a tiny one: they overflow and underflow."""
    exponentials(np.array([2.5]), np.array([1e-3]), frame_s=2.5)


@AREA.against("their mean, with the error of a mean")
def hold_of_a_century() -> Answer:
    """Frames so late that every exponential underflows."""
    weights, taus_s = np.array([0.3, 0.2]), np.array([5.0, 30.0])
    kernel = RelaxationKernel(True, weights, taus_s, np.eye(4) * 1e-4, 0.1 * weights, 8, 9)
    steady = predict_steady(3e9 + _TIME_S, np.full(25, 0.7), 0.01, kernel)
    spread = relative_error(float(steady.stderr[0]), 0.01 / 5)
    return answer_from_condition(relative_error(float(steady.values[0]), 0.7) + spread, 1.0)


@AREA.against("it begins at once")
def unloading_without_a_spike() -> Answer:
    """A return of equal samples has no peak to start after."""
    return spike_of(np.full(24, 0.3), 0)


@AREA.against("it begins after the first of them")
def unloading_with_a_plateau_for_a_spike() -> Answer:
    """Three samples share the peak: ties."""
    return spike_of(np.concatenate([[0.0, 0.5, 1.0, 1.0, 1.0], np.linspace(0.9, 0, 8), np.zeros(11)]), 3)
