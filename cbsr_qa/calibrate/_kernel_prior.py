"""Weights and time constants that relaxations share, and how the weights scatter between loads (empirical Bayes)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibrate._kernel_basis import exponentials

Array = NDArray[np.float64]

#: Relative scatters tried; every one up to 1 is as likely before anything was seen.
_SCATTERS: Final = np.linspace(0.0, 1.0, 61) ** 2
#: Residual degrees of freedom from which on a load's own noise is used, not that of all loads.
_OWN_NOISE: Final = 8
#: No value is taken to be better than this share of its load: the covariances stay invertible.
_LEAST_NOISE: Final = 1e-6
#: Times the exponentials are expanded about new time constants.
_ROUNDS: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class KernelTrace:
    """A load to learn from.

    Parameters
    ----------
    time_s, values : (n,).
    ramp_s : of the ramp before.
    released : D of an unloading; None for a loading.
    """

    time_s: Array
    values: Array
    ramp_s: float
    released: float | None


@dataclass(frozen=True, slots=True, eq=False)
class SharedKernel:
    """Posterior of w and log τ, and the scatter of w relative to w.

    Parameters
    ----------
    weights, time_constants_s : (k,).
    covariance : (2 k, 2 k).
    relative_scatter : between loads.
    freedom : degrees of freedom of its square.
    """

    weights: Array
    time_constants_s: Array
    covariance: Array
    relative_scatter: float
    freedom: float


def shared_kernel(
    traces: Sequence[KernelTrace],
    weights: Array,
    time_constants_s: Array,
    prior_stderr: Array,
    *,
    frame_s: float,
    noise: Sequence[float] | None = None,
) -> SharedKernel:
    """Estimate the mean kernel of all loads and how much each load's weights differ from it.

    Load i is Aᵢ (1 + Σ wᵢ e^(−t/τ)) or Rᵢ + Dᵢ Σ wᵢ e^(−t/τ), with wᵢ ~ N(w, s² w²) independently. Aᵢ or Rᵢ are
    integrated out under a flat prior; w and log τ are found by Gauss–Newton at every s of a grid, and their
    restricted likelihood says how likely that s is. The loads' sizes are plugged into the scatter's covariance.

    Parameters
    ----------
    weights, time_constants_s : (k,) to begin with.
    prior_stderr : (2 k,) of the weak normal prior of (w, log τ) about them; 0 keeps one fixed.
    noise : standard deviation of a value of each load; None to take it from the residuals.
    """
    mean = start = np.concatenate([weights, np.log(time_constants_s)])
    free = prior_stderr > 0
    precision = 1 / prior_stderr[free] ** 2
    for _ in range(_ROUNDS):
        reduced = _Reduced(traces, mean, frame_s, noise)
        steps, inverse, likely = reduced.searched(free, precision, (start - mean)[free])
        mean = mean.copy()
        mean[free] += likely @ steps
    around = steps - likely @ steps
    covariance = np.zeros((len(mean), len(mean)))
    covariance[np.ix_(free, free)] = np.einsum("g,gij->ij", likely, inverse) + (likely[:, None] * around).T @ around
    scatter, freedom = _as_variance(likely)
    half = len(weights)
    return SharedKernel(mean[:half], np.exp(mean[half:]), covariance, scatter, freedom)


class _Reduced:
    """Every load in the few dimensions in which kernels near the present one differ.

    Parameters
    ----------
    mean : (2 k,) w and log τ to expand about.
    """

    def __init__(
        self, traces: Sequence[KernelTrace], mean: Array, frame_s: float, noise: Sequence[float] | None
    ) -> None:
        half = len(mean) // 2
        self.weights = mean[:half]
        loads = [_projected(trace, self.weights, np.exp(mean[half:]), frame_s) for trace in traces]
        self.data, self.level, self.parts, self.slopes, self.size = (
            np.array(one) for one in zip(*(load[:5] for load in loads), strict=True)
        )
        squares, spare = (np.array(one, dtype=np.float64) for one in zip(*(load[5:] for load in loads), strict=True))
        pooled = squares.sum() / max(float(spare.sum()), 1.0)
        own = np.where(spare >= _OWN_NOISE, squares / np.maximum(spare, 1), pooled)
        given = own if noise is None else np.asarray(noise, dtype=np.float64) ** 2
        least = (_LEAST_NOISE * self.size) ** 2 + np.finfo(np.float64).tiny
        self.variance = np.maximum(given, least)

    def searched(self, free: NDArray[np.bool_], precision: Array, back: Array) -> tuple[Array, Array, Array]:
        """Steps (g, f), covariances (g, f, f) and likelihoods (g,) at each relative scatter of the grid.

        ``back`` leads from the present mean to the prior's.
        """
        slopes = self.slopes[:, :, free] * self.size[:, None, None]
        spread = self.parts * (self.size[:, None] * self.weights)[:, None, :]
        outer = spread @ spread.transpose(0, 2, 1)
        identity = np.eye(self.data.shape[1]) * self.variance[:, None, None]
        covariance = identity + _SCATTERS[:, None, None, None] ** 2 * outer
        inverse = np.linalg.inv(covariance)
        level = np.einsum("gnij,nj->gni", inverse, self.level)
        weight = np.einsum("gni,ni->gn", level, self.level)
        across = inverse - level[..., :, None] * level[..., None, :] / weight[..., None, None]
        seen = np.einsum("gnij,nj->gni", across, self.data)
        information = np.einsum("nia,gnij,njb->gab", slopes, across, slopes, optimize=True) + np.diag(precision)
        pull = np.einsum("nia,gni->ga", slopes, seen) + precision * back
        posterior = np.linalg.inv(information)
        steps = np.einsum("gab,gb->ga", posterior, pull)
        explained = np.einsum("ga,ga->g", pull, steps)
        left = np.einsum("gni,ni->g", seen, self.data) - explained
        volume = np.linalg.slogdet(covariance)[1].sum(axis=1) + np.log(weight).sum(axis=1)
        log_likelihood = -0.5 * (left + volume + np.linalg.slogdet(information)[1])
        likely = np.exp(log_likelihood - log_likelihood.max()) * np.gradient(_SCATTERS)
        return steps, posterior, likely / likely.sum()


def _projected(
    trace: KernelTrace, weights: Array, time_constants_s: Array, frame_s: float
) -> tuple[Array, Array, Array, Array, float, float, int]:
    """Coordinates of values, level, exponentials and slopes; the size; what is left, and how many to spare."""
    parts, by_log = exponentials(trace.time_s, time_constants_s, ramp_s=trace.ramp_s, frame_s=frame_s)
    relaxing = parts @ weights
    level = np.ones_like(relaxing) if trace.released is not None else 1 + relaxing
    columns = np.column_stack([level, parts, weights * by_log])
    basis = np.linalg.svd(columns, full_matrices=False)[0]
    data = basis.T @ trace.values
    left = trace.values - basis @ data
    size = float(trace.values @ level / (level @ level)) if trace.released is None else trace.released
    if trace.released is not None:
        data = data - basis.T @ (trace.released * relaxing)
    coordinates = basis.T @ columns
    half = len(weights)
    spare = max(len(trace.values) - columns.shape[1], 0)
    parts, slopes = coordinates[:, 1 : 1 + half], coordinates[:, 1:]
    return data, coordinates[:, 0], parts, slopes, size, float(left @ left), spare


def _as_variance(likely: Array) -> tuple[float, float]:
    """The scaled inverse χ² with the mean and variance of s²: its scale's root and degrees of freedom."""
    square = _SCATTERS**2
    mean = float(likely @ square)
    spread = max(float(likely @ (square - mean) ** 2), 1e-9 * mean**2)
    freedom = 4 + 2 * mean**2 / spread
    return float(np.sqrt(mean * (freedom - 2) / freedom)), freedom
