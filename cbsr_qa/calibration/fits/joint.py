"""Variable projection over many traces that share one shape; the search is over the shape only."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from cbsr_qa.calibration.fits.separable import best_fit
from cbsr_qa.domain.numbers import Array

#: Times (n,) and values (n,) of one trace.
TimedValues = tuple[Array, Array]


@dataclass(frozen=True, slots=True, eq=False)
class JointExponentials:
    """A least-squares fit of cᵢ + sᵢ g(t) to traces i, g a sum of one or two decaying exponentials with g(0) = 1.

    Parameters
    ----------
    time_constants_s : (k,) rising [s].
    shares : (k,) shares of the exponentials in g; they add to 1.
    offsets, scales : (traces,) cᵢ and sᵢ, in the unit of the values.
    residual : (all points,) values − fit.
    mean_covariance : (1 + 2 k, 1 + 2 k) covariance of the mean trace's offset, its amplitudes, and log τ.
    """

    time_constants_s: Array
    shares: Array
    offsets: Array
    scales: Array
    residual: Array
    mean_covariance: Array

    @property
    def amplitudes(self) -> Array:
        """Amplitudes of the mean trace at t = 0, (k,)."""
        amplitudes: Array = self.shares * self.scales.mean()
        return amplitudes

    @property
    def log_stderr(self) -> Array:
        """Standard errors of log τ, (k,)."""
        return np.sqrt(np.diag(self.mean_covariance))[1 + len(self.shares) :]


def fit_joint(
    traces: Sequence[TimedValues], starts: Sequence[Sequence[float]], bounds_s: tuple[float, float]
) -> JointExponentials:
    """Fit from several starts and keep the best.

    Parameters
    ----------
    traces : at least one trace, each with more than two points.
    starts : log τ of one exponential, or (log τ₁, log τ₂, share of the first) of two.
    bounds_s : lowest and highest time constant.
    """
    problem = _Joint(traces)
    lowest, highest = np.log(bounds_s)
    lower, upper = ([lowest], [highest]) if len(starts[0]) == 1 else ([lowest] * 2 + [-2.0], [highest] * 2 + [3.0])
    bounds = np.array(lower), np.array(upper)
    begun = [np.clip(start, *bounds) for start in starts]
    return problem.assemble(best_fit(problem.residual, problem.jacobian, begun, bounds))


class _Joint:
    """Residual and Jacobian over the shape's parameters; scale and offset of every trace follow from them.

    Golub & Pereyra 1973 with Kaufman's Jacobian, trace by trace: the design is block diagonal.
    """

    def __init__(self, traces: Sequence[TimedValues]) -> None:
        # All points in one row, since a run has dozens of short traces and separate calls would be slow.
        self._time_s = np.concatenate([time_s for time_s, _ in traces])
        self._counts = np.array([len(values) for _, values in traces])
        self._first = np.cumsum(self._counts) - self._counts
        self._means = np.array([values.mean() for _, values in traces])
        self._centred = np.concatenate([values - values.mean() for _, values in traces])
        self._size = float(np.sqrt(self._centred @ self._centred)) or 1.0

    def residual(self, shape: Array) -> Array:
        basis, scales = self._project(shape)
        return (self._centred - self._spread(scales) * basis) / self._size

    def jacobian(self, shape: Array) -> Array:
        basis, scales = self._project(shape)
        slope = self._spread(scales)[:, None] * self._subtract_means(_slopes(self._time_s, shape))
        projections = self._sum_traces(basis[:, None] * slope) / self._squares(basis)[:, None]
        return (basis[:, None] * self._spread(projections) - slope) / self._size

    def assemble(self, shape: Array) -> JointExponentials:
        if len(shape) == 3 and shape[0] > shape[1]:
            shape = np.array([shape[1], shape[0], 1 - shape[2]])
        _, scales = self._project(shape)
        levels = self._sum_traces(_shape(self._time_s, shape)) / self._counts
        residual = self.residual(shape) * self._size
        spare = max(len(residual) - 2 * len(scales) - len(shape), 1)
        variance = float(residual @ residual) / spare
        shares = np.array([1.0]) if len(shape) == 1 else np.array([shape[2], 1 - shape[2]])
        return JointExponentials(
            np.exp(shape[: len(shares)]),
            shares,
            self._means - scales * levels,
            scales,
            residual,
            variance * self._covariance(shape, scales),
        )

    def _project(self, shape: Array) -> tuple[Array, Array]:
        """Centred basis of all points, and scale of every trace."""
        basis = self._subtract_means(_shape(self._time_s, shape))
        return basis, self._sum_traces(basis * self._centred) / self._squares(basis)

    def _sum_traces(self, points: Array) -> Array:
        return np.add.reduceat(points, self._first)

    def _squares(self, basis: Array) -> Array:
        return np.maximum(self._sum_traces(basis**2), np.finfo(np.float64).tiny)

    def _spread(self, values: Array) -> Array:
        return np.repeat(values, self._counts, axis=0)

    def _subtract_means(self, points: Array) -> Array:
        counts = self._counts.reshape(-1, *[1] * (points.ndim - 1))
        return points - self._spread(self._sum_traces(points) / counts)

    def _covariance(self, shape: Array, scales: Array) -> Array:
        """Covariance, per unit variance of the noise, of the mean trace's offset, amplitudes and log τ."""
        count = len(scales)
        # Not from the normal equations, which would treat nearly equal shapes as determined.
        root = np.asarray(np.linalg.pinv(self.jacobian(shape) * self._size), dtype=np.float64)
        shape_covariance: Array = root @ root.T
        level_covariance, turn = np.zeros((2, 2)), np.zeros((2, len(shape)))
        for time_s, scale in zip(np.split(self._time_s, self._first[1:]), scales, strict=True):
            inverse = np.linalg.pinv(np.column_stack([np.ones_like(time_s), _shape(time_s, shape)]))
            level_covariance += inverse @ inverse.T / count**2
            turn -= inverse @ (scale * _slopes(time_s, shape)) / count
        linear = np.vstack([np.column_stack([np.eye(2), turn]), np.eye(len(shape) + 2)[2:]])
        to_amplitudes = _transform_to_amplitudes(shape, float(scales.mean())) @ linear
        return to_amplitudes @ block_diag(level_covariance, shape_covariance) @ to_amplitudes.T


def _shape(time_s: Array, shape: Array) -> Array:
    curve: Array = np.exp(-time_s / np.exp(shape[0]))
    if len(shape) == 3:
        curve = shape[2] * curve + (1 - shape[2]) * np.exp(-time_s / np.exp(shape[1]))
    return curve


def _slopes(time_s: Array, shape: Array) -> Array:
    """Derivatives of the shape with respect to log τ and, for two exponentials, the share of the first."""
    tau = np.exp(shape[:2]) if len(shape) == 3 else np.exp(shape)
    decays = np.exp(-time_s[:, None] / tau)
    slopes: Array = decays * time_s[:, None] / tau
    if len(shape) == 3:
        slopes = np.column_stack([slopes * [shape[2], 1 - shape[2]], decays[:, 0] - decays[:, 1]])
    return slopes


def _transform_to_amplitudes(shape: Array, scale: float) -> Array:
    """From (offset, scale, log τ…[, share]) to (offset, amplitudes…, log τ…)."""
    if len(shape) == 1:
        return np.eye(3)
    share = float(shape[2])
    rows = [[1, 0, 0, 0, 0], [0, share, 0, 0, scale], [0, 1 - share, 0, 0, -scale], [0, 0, 1, 0, 0], [0, 0, 0, 1, 0]]
    return np.array(rows, dtype=np.float64)
