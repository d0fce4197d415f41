"""Fitted relaxations and quantities derived from them."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.kept import FROM_ABOVE, OWN, Kept
from cbsr_qa.domain.numbers import Array


class FitStatus(StrEnum):
    """Status of a relaxation fit."""

    TWO = "two exponentials"
    ONE = "one exponential"  #: the second was not distinguishable
    FLAT = "no relaxation"  #: inside the settling band from the start
    DRIFTING = "still drifting"  #: slower than the trace is long: settles later than its window
    REJECTED = "rejected"  #: R² below the gate, or too few points


@dataclass(frozen=True, slots=True)
class RelaxationFit:
    """G(t) = a₀ + a₁ e^(−t/τ₁) + a₂ e^(−t/τ₂), t from the end of the ramp (paper Eq 3).

    Parameters
    ----------
    offset : a₀, in the trace's unit.
    amplitudes : (a₁[, a₂]).
    time_constants_s : (τ₁[, τ₂]) rising [s].
    offset_stderr, time_constant_stderr_s : one standard deviation each.
    r_squared : share of the variance explained.
    why : reason of a fallback or a rejection.
    """

    status: FitStatus
    offset: Annotated[float, Kept(units=OWN)]
    amplitudes: Annotated[tuple[float, ...], Kept(units=OWN)]
    time_constants_s: tuple[float, ...]
    offset_stderr: Annotated[float, Kept(units=OWN)]
    time_constant_stderr_s: Annotated[tuple[float, ...], Kept("time_constants_stderr")]
    r_squared: float
    why: str


@dataclass(frozen=True, slots=True)
class SettlingTime:
    """Settling of one trace.

    Parameters
    ----------
    value_s : the last time the fitted curve leaves the band [s]; the window's length if censored;
        None if the fit was rejected.
    censored : whether it is still outside the band when the window ends: it takes at least ``value_s``.
    band : half width of the band in the trace's unit.
    why : reason if ``value_s`` is None or censored.
    """

    value_s: Annotated[float | None, Kept("time")]
    censored: bool
    band: Annotated[float, Kept(units=OWN)]
    why: str


@dataclass(frozen=True, slots=True, eq=False)
class RelaxationKernel:
    """Parameters common to all relaxations of a sensor, which predict its next load and the uncertainty of that.

    The change after a step is A K(t), K(t) = 1 + w₁ e^(−t/τ₁) + w₂ e^(−t/τ₂), A the steady change. After a release it
    is R + D (w₁ e^(−t/τ₁) + w₂ e^(−t/τ₂)), D the change that was released and R what is left at the end.

    Parameters
    ----------
    loading : True after a press, False after a release.
    weights : (k,) w, relative to the steady or the released change; none where nothing relaxes.
    time_constants_s : (k,) τ rising [s].
    covariance : (2 k, 2 k) covariance of (w, log τ): how well their means are known.
    scatter : (k,) standard deviation of each weight from load to load, beyond what noise explains.
    scatter_freedom : degrees of freedom of ``scatter``: how well it is known.
    loads : number of loads that the kernel was learned from.
    start_s : time after the step from which on it holds; earlier frames may show an unloading spike [s].
    why : why there is no kernel; empty if there is one.
    """

    loading: Annotated[bool, FROM_ABOVE]
    weights: Annotated[Array, Kept(dims="k", most=np.inf)]
    time_constants_s: Annotated[Array, Kept(dims="k", most=np.inf)]
    covariance: Annotated[Array, Kept(dims="2k 2k", most=np.inf)]
    scatter: Annotated[Array, Kept(dims="k", least=0)]
    scatter_freedom: float
    loads: int
    start_s: float = 0.0
    why: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class SteadyPrediction:
    """Predicted end values of holds (or releases), from their observed part.

    Parameters
    ----------
    values : (m,) steady change A, or what a release leaves R, in the traces' unit.
    stderr : (m,) one standard error.
    freedom : (m,) degrees of freedom of Student's t for intervals; infinite where only the noise, which is given,
        contributes.
    misfit : (m,) χ² of the observed frames against the kernel, over its ``spare`` degrees of freedom. Well above 1
        the load is no plain hold. 0 where ``spare`` is 0.
    spare : (m,) degrees of freedom of that χ²: frames − 1.
    """

    values: Array
    stderr: Array
    freedom: Array
    misfit: Array
    spare: NDArray[np.int64]
