"""Relative conductance change against stress or strain (paper Eqs 1 and 2)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, finite_numbers
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic

#: Largest difference, as a share of their size, between places that count as one.
_COLLINEAR: Final = 1e-9
#: Largest number that can be squared and divided safely; the smallest is its inverse.
_LARGEST: Final = 1e70
#: Error of all-zero changes without a stated one: small, with a finite square.
_NO_ERROR: Final = 1e-120


@dataclass(frozen=True, slots=True, eq=False)
class QuasiStaticFit:
    """Δρ/ρ₀ = slope · x + intercept, with its data.

    Parameters
    ----------
    slope, intercept : α and β.
    covariance : (2, 2) float64 of (slope, intercept).
    levels : fitted strains, rising.
    excluded : strains left out because their deviation exceeds their mean change.
    chi_squared, degrees : χ² of the weighted residuals, and its degrees of freedom: levels − 2.
    """

    slope: float
    intercept: float
    covariance: Array
    levels: tuple[float, ...]
    excluded: tuple[float, ...]
    chi_squared: float
    degrees: int

    def as_parameters(self, source: str) -> QuasiStatic:
        """Return the fit with its standard errors and source."""
        slope_error, intercept_error = np.sqrt(np.diag(self.covariance))
        left_out = ", ".join(f"{100 * strain:g} %" for strain in self.excluded)
        where_from = f"{source}; left out: {left_out}" if left_out else source
        return QuasiStatic(
            Parameter(self.slope, float(slope_error), where_from),
            Parameter(self.intercept, float(intercept_error), where_from),
            float(self.covariance[0, 1]),
        )


def fit_quasi_static(
    strain: Sequence[float], x: Sequence[float], change: Sequence[float], stderr: Sequence[float] | None = None
) -> QuasiStaticFit:
    """Fit a line through the mean change of each strain by weighted least squares.

    A strain's weight is one over the squared standard error of its mean: from the scatter of its loads, at least
    their stated errors; a strain with a single load and no stated error takes the pooled scatter. Strains whose
    deviation exceeds their mean change are left out and named (the paper left out 5 % for 9 wt%). If the line misses
    the means by more than their errors, the covariance is scaled by χ² per degree (Birge).

    Parameters
    ----------
    strain : (n,) nominal strain of each load; loads with equal strain form a level.
    x : (n,) stress [kPa] or strain of each load.
    change : (n,) relative conductance change at steady state.
    stderr : (n,) standard errors of the changes; None if unknown.

    Raises
    ------
    NumericsError
        If the lengths differ, a number is not finite, x or changes are beyond 1e±70, fewer than two levels are left,
        or their x coincide, so that slope and intercept cannot be separated.
    """
    level, place, value = _check_points(strain, x, change)
    stated_stderr = np.zeros(len(value)) if stderr is None else finite_numbers(stderr, "standard errors")
    strains = np.unique(level)
    means = np.array([value[level == s].mean() for s in strains])
    errors, deviations = _errors(level, value, stated_stderr, strains)
    kept_mask = deviations <= np.abs(means)
    if kept_mask.sum() < 2:
        raise NumericsError(
            f"{int(kept_mask.sum())} of {len(strains)} strains can be fitted; slope and intercept need two",
            remedy="press at two strains or more, each clear of its own scatter",
        )
    places = np.array([place[level == s].mean() for s in strains])[kept_mask]
    if np.ptp(places) <= _COLLINEAR * np.abs(places).max():
        raise NumericsError(
            f"all loads lie at x = {places[0]:g}: slope and intercept cannot be told apart",
            remedy="press at clearly different strains",
        )
    solution, covariance, chi_squared = _fit_weighted_line(places, means[kept_mask], errors[kept_mask])
    degrees = int(kept_mask.sum()) - 2
    return QuasiStaticFit(
        float(solution[0]),
        float(solution[1]),
        covariance * max(1.0, chi_squared / degrees if degrees else 1.0),
        tuple(strains[kept_mask].tolist()),
        tuple(strains[~kept_mask].tolist()),
        chi_squared,
        degrees,
    )


def _check_points(strain: Sequence[float], x: Sequence[float], change: Sequence[float]) -> tuple[Array, Array, Array]:
    level, place, value = (np.asarray(numbers, dtype=np.float64) for numbers in (strain, x, change))
    if not len(level) == len(place) == len(value):
        raise NumericsError(f"{len(level)} strains, {len(place)} places and {len(value)} changes do not fit together")
    if not all(np.isfinite(numbers).all() for numbers in (level, place, value)):
        raise NumericsError("a quasi-static fit was given a number that is not finite")
    for name, numbers in (("x", place), ("change", value)):
        size = float(np.abs(numbers).max(initial=0.0))
        if size and not 1 / _LARGEST <= size <= _LARGEST:
            raise NumericsError(
                f"a quasi-static fit was given {name} of {size:.3g}: its square is outside the range of numbers",
                remedy="state it in another unit",
            )
    return np.round(level, 9), place, value


def _errors(level: Array, value: Array, given: Array, strains: Array) -> tuple[Array, Array]:
    """Standard error of each level's mean, and each level's deviation (0 for a single load)."""
    counts = np.array([(level == s).sum() for s in strains])
    deviations = np.array(
        [value[level == s].std(ddof=1) if n > 1 else 0.0 for s, n in zip(strains, counts, strict=True)]
    )
    spare = int((counts - 1).sum())
    pooled = float(np.sqrt(((counts - 1) * deviations**2).sum() / spare)) if spare else 0.0
    scatter = np.where(counts > 1, deviations, pooled)
    stated_rms = np.array([np.sqrt((given[level == s] ** 2).mean()) for s in strains])
    errors = np.maximum(scatter, stated_rms) / np.sqrt(counts)
    # Without scatter all levels have equal weight; the error is that of rounding.
    least = 1e-12 * float(max(np.abs(value).max(initial=0.0), stated_rms.max(initial=0.0))) or _NO_ERROR
    return np.maximum(errors, least), deviations


def _fit_weighted_line(x: Array, y: Array, error: Array) -> tuple[Array, Array, float]:
    """Slope and intercept, their covariance and χ², by QR of the weighted design centred at its mean."""
    weight = 1 / error
    middle = float(np.average(x, weights=weight**2))
    q, r = np.linalg.qr(np.column_stack([x - middle, np.ones_like(x)]) * weight[:, None])
    centred = np.linalg.solve(r, q.T @ (y * weight))
    from_centred = np.array([[1.0, 0.0], [-middle, 1.0]])
    inverse = from_centred @ np.linalg.inv(r)
    residual = (y - centred[0] * (x - middle) - centred[1]) * weight
    return from_centred @ centred, inverse @ inverse.T, float(residual @ residual)
