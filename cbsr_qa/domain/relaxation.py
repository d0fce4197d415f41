"""Fitted relaxations and what follows from them."""

from dataclasses import dataclass
from enum import StrEnum


class FitStatus(StrEnum):
    """What became of a relaxation fit."""

    TWO = "two exponentials"
    ONE = "one exponential"  #: the second could not be told apart
    FLAT = "no relaxation"  #: inside the settling band from the start
    DRIFTING = "still drifting"  #: slower than the trace is long: settles later than its window
    REJECTED = "rejected"  #: R² below the gate, or too few points


@dataclass(frozen=True, slots=True)
class RelaxationFit:
    """G(t) = a₀ + a₁ e^(−t/τ₁) + a₂ e^(−t/τ₂), t from the end of the ramp (paper Eq 3).

    Parameters
    ----------
    status : which form was kept.
    offset : a₀, in the trace's unit.
    amplitudes : (a₁[, a₂]).
    time_constants_s : (τ₁[, τ₂]) rising [s].
    offset_stderr, time_constant_stderr_s : one standard deviation each.
    r_squared : share of the variance explained.
    why : reason of a fallback or a rejection.
    """

    status: FitStatus
    offset: float
    amplitudes: tuple[float, ...]
    time_constants_s: tuple[float, ...]
    offset_stderr: float
    time_constant_stderr_s: tuple[float, ...]
    r_squared: float
    why: str


@dataclass(frozen=True, slots=True)
class SettlingTime:
    """Settling of one trace.

    Parameters
    ----------
    value_s : the last time the fitted curve leaves the band [s]; the window's length if censored;
        None if the fit was rejected.
    censored : still outside the band at the end of the window: at least ``value_s``.
    band : half width of the band in the trace's unit.
    why : in words, where there is no plain number.
    """

    value_s: float | None
    censored: bool
    band: float
    why: str
