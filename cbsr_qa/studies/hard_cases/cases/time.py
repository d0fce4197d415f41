"""Hard cases of time stamps: repeated, decreasing, far from zero, all equal."""

from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.fits import exponentials, fit_relaxation, learn_kernel, predict_steady, relaxation_start
from cbsr_qa.domain import NumericsError
from cbsr_qa.domain.results import RelaxationKernel
from cbsr_qa.studies.hard_cases.case import Answer, HardCase, conditioned_bound
from cbsr_qa.studies.hard_cases.exact import largest_relative_error, mean_exponential, relative_error

Array = NDArray[np.float64]

_AREA: Final = "time"
_TIME_S: Final[Array] = 2.5 * np.arange(25.0)
_CURVE: Final[Array] = 1.0 + 0.3 * np.exp(-_TIME_S / 5) + 0.2 * np.exp(-_TIME_S / 30)


def fitted(time_s: Array) -> Answer:
    """Offset of a fit over such times."""
    return Answer(abs(fit_relaxation(time_s, _CURVE).offset - 1), 0.0)


def irregular() -> Answer:
    """Time constants of a trace whose frames are 1e-9 to 30 s apart."""
    time_s = np.cumsum(10.0 ** np.linspace(-9, 1.5, 30))
    parts = np.exp(-time_s[:, None] / [5.0, 30.0])
    values = 1 + parts @ [0.3, 0.2]
    fit = fit_relaxation(time_s, values)
    design = np.column_stack([np.ones_like(time_s), parts, parts * time_s[:, None] / [5.0, 30.0] * [0.3, 0.2]])
    condition = float(np.linalg.norm(np.linalg.pinv(design)[3:], axis=1).max() * np.linalg.norm(values))
    found = [*fit.time_constants_s, *fit.amplitudes]
    error = largest_relative_error(found, [5, 30, 0.3, 0.2]) if len(found) == 4 else 1.0
    return Answer(error, conditioned_bound(condition), condition)


def short_ramp(share: float) -> Answer:
    """Exponential after a ramp, averaged over a frame, both this share of its time constant."""
    tau_s, time_s = 8.0, 3.0
    values, slopes = exponentials(np.array([time_s]), np.array([tau_s]), ramp_s=share * tau_s, frame_s=share * tau_s)
    exact = mean_exponential(time_s, tau_s, share * tau_s, share * tau_s)
    return Answer(largest_relative_error([values[0, 0], slopes[0, 0]], exact), conditioned_bound(2.0), 2.0)


def long_frame() -> Answer:
    """Exponential of a millisecond in frames of 2.5 s."""
    values, _ = exponentials(np.array([2.5]), np.array([1e-3]), frame_s=2.5)
    return Answer(float(values[0, 0]), 0.0)


def long_after(time_s: float) -> Answer:
    """Steady state seen so long after the ramp that every exponential underflows."""
    weights, taus_s = np.array([0.3, 0.2]), np.array([5.0, 30.0])
    kernel = RelaxationKernel(True, weights, taus_s, np.eye(4) * 1e-4, 0.1 * weights, 8, 9)
    found = predict_steady(time_s + _TIME_S, np.full(25, 0.7), 0.01, kernel)
    spread = relative_error(float(found.stderr[0]), 0.01 / 5)
    return Answer(relative_error(float(found.values[0]), 0.7) + spread, conditioned_bound(1.0), 1.0)


def spike_of(values: Array, expected: int) -> Answer:
    """Where the relaxation begins behind an unloading spike."""
    return Answer(float(abs(relaxation_start(values) - expected)), 0.0, unit="samples")


def one_instant() -> Answer:
    """Kernel of loads that were all seen at one instant."""
    kernel = learn_kernel([(np.full(8, 3.0), np.linspace(1, 2, 8))] * 3)
    return Answer(float(len(kernel.weights)), 0.0)


CASES: Final[tuple[HardCase, ...]] = (
    HardCase(
        "time-stamps-that-repeat",
        _AREA,
        "Two samples with one time stamp: at most one of them is right.",
        "refusal",
        partial(fitted, np.minimum(_TIME_S, 50.0)),
        NumericsError,
    ),
    HardCase(
        "time-stamps-that-step-back",
        _AREA,
        "A clock that was set back in the middle of a trace.",
        "refusal",
        partial(fitted, np.where(_TIME_S > 30, _TIME_S - 10, _TIME_S)),
        NumericsError,
    ),
    HardCase(
        "time-stamps-that-round-together",
        _AREA,
        "Frames a nanosecond apart, counted from 1970: a double has no room for them.",
        "refusal",
        partial(fitted, 1.7e9 + 1e-9 * _TIME_S),
        NumericsError,
    ),
    HardCase(
        "all-at-one-instant", _AREA, "Loads whose samples all have one time.", "refusal", one_instant, NumericsError
    ),
    HardCase(
        "frames-at-irregular-times",
        _AREA,
        "Frames from a nanosecond to half a minute apart in one trace.",
        "the parameters the trace was made from",
        irregular,
    ),
    HardCase(
        "ramp-much-shorter-than-a-time-constant",
        _AREA,
        "What ramp and frame do to an exponential are differences of numbers that agree to six digits.",
        "the integrals in fifty digits",
        partial(short_ramp, 1e-6),
    ),
    HardCase(
        "ramp-as-long-as-a-time-constant",
        _AREA,
        "The same where a power series would not converge quickly.",
        "the integrals in fifty digits",
        partial(short_ramp, 1.1),
    ),
    HardCase(
        "frame-of-a-thousand-time-constants",
        _AREA,
        "The mean of an exponential over a frame is a huge number times a tiny one: they overflow and underflow.",
        "refusal",
        long_frame,
        NumericsError,
    ),
    HardCase(
        "hold-of-a-century",
        _AREA,
        "Frames so late that every exponential underflows.",
        "their mean, with the error of a mean",
        partial(long_after, 3e9),
    ),
    HardCase(
        "unloading-without-a-spike",
        _AREA,
        "A return of equal samples has no peak to start after.",
        "it begins at once",
        partial(spike_of, np.full(24, 0.3), 0),
    ),
    HardCase(
        "unloading-with-a-plateau-for-a-spike",
        _AREA,
        "Three samples share the peak: ties.",
        "it begins after the first of them",
        partial(spike_of, np.concatenate([[0.0, 0.5, 1.0, 1.0, 1.0], np.linspace(0.9, 0, 8), np.zeros(11)]), 3),
    ),
)
