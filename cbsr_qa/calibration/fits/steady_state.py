"""Transient compensation: the end of a hold or a release from its first part and the sensor's own relaxations."""

from typing import Final, Self

import numpy as np
from scipy.special import stdtrit

from cbsr_qa.calibration.fits.relaxation import observable_share
from cbsr_qa.calibration.fits.relaxation_kernel import learn_kernel
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.relaxation import RelaxationKernel, SteadyPrediction

__all__ = ["HoldsSoFar", "event_rate_per_min", "interval", "learn_kernel", "predict_steady"]


#: Number of times the scatter's share of the covariance is updated with the predicted size.
_ROUNDS: Final = 3
#: Time constants after which the residue is negligible.
_OVER: Final = 700.0


def predict_steady(
    time_s: Array,
    values: Array,
    noise: float | Array,
    kernel: RelaxationKernel,
    *,
    ramp_s: float | Array = 0.0,
    frame_s: float = 0.0,
    released: float | Array | None = None,
    released_stderr: float | Array = 0.0,
    at_s: float = np.inf,
) -> SteadyPrediction:
    """Predict the end of holds or releases from their observed part.

    Bayesian linear regression of the steady change A and its weights A w, with the kernel as prior of the weights and
    no prior of A; the kernel's own uncertainty enters to first order. For a release, the residue R has no prior. Once
    settled, the result is the noise-weighted mean.

    Parameters
    ----------
    time_s : (n,) or (m, n) from the end of the ramp [s]; frames before ``kernel.start_s`` are ignored.
    values : (n,) or (m, n) of m traces.
    noise : standard deviation of a value; broadcast with ``values``.
    ramp_s, frame_s : arguments of :func:`learn_kernel`; ``ramp_s`` may be (m,).
    released, released_stderr : D and its standard error, for a kernel of unloadings; may be (m,).
    at_s : predict the change at this time after the ramp's end instead, e.g. when a rest is over.

    Raises
    ------
    NumericsError
        If there is no kernel or no frame, a number is not finite, the noise is not positive, or ``released`` is
        missing or not for this kernel.
    """
    values = np.atleast_2d(np.asarray(values, dtype=np.float64))
    time_s = np.broadcast_to(np.asarray(time_s, dtype=np.float64), values.shape)
    noise = np.broadcast_to(np.asarray(noise, dtype=np.float64), values.shape)
    holds = HoldsSoFar(kernel, len(values), ramp_s=ramp_s, frame_s=frame_s)
    for frame in range(values.shape[1]):
        holds.add(time_s[:, frame], values[:, frame], noise[:, frame])
    return holds.predict(released=released, released_stderr=released_stderr, at_s=at_s)


def interval(prediction: SteadyPrediction, level: float) -> tuple[Array, Array]:
    """Return the lower and upper ends (m,) of the central intervals of a level such as 0.95."""
    if not 0 < level < 1:
        raise NumericsError(f"an interval cannot have the level {level}", remedy="levels lie between 0 and 1")
    reach = stdtrit(np.minimum(prediction.freedom, 1e9), (1 + level) / 2) * prediction.stderr
    return prediction.values - reach, prediction.values + reach


def event_rate_per_min(
    loading_s: float, unloading_s: float, *, held: float = 1.5, rested: float = 1.5, ramp_s: float = 0.0
) -> float:
    """Return how many presses per minute can be separated and measured.

    NumericsError if a time is negative or not finite, or all times are zero.

    Parameters
    ----------
    loading_s, unloading_s : settling times.
    held, rested : waiting times relative to them; 1.5 each without transient compensation (paper 4.3.2), less with.
    ramp_s : duration of one press, and of one release.
    """
    numbers = (loading_s, unloading_s, held, rested, ramp_s)
    period_s = held * loading_s + rested * unloading_s + 2 * ramp_s
    if not (all(np.isfinite(number) and number >= 0 for number in numbers) and period_s > 0):
        raise NumericsError(f"times that give no event rate: {', '.join(f'{number:g}' for number in numbers)}")
    return 60 / period_s


class HoldsSoFar:
    """Accumulates m holds (or releases) frame by frame, at constant cost and memory.

    NumericsError if there is no kernel.

    Parameters
    ----------
    kernel, ramp_s, frame_s : arguments of :func:`predict_steady`.
    count : m.
    """

    def __init__(
        self, kernel: RelaxationKernel, count: int = 1, *, ramp_s: float | Array = 0.0, frame_s: float = 0.0
    ) -> None:
        if kernel.why:
            raise NumericsError(
                f"no steady state can be predicted: {kernel.why}", remedy="calibrate with longer holds, or wait"
            )
        self._kernel = kernel
        ramps = np.broadcast_to(np.asarray(ramp_s, dtype=np.float64), (count,))
        self._share, self._slope = observable_share(kernel.time_constants_s, ramp_s=ramps, frame_s=frame_s)
        self._root = _root(kernel)
        # All rows and values as the triangle of their QR: sums of squares would keep half of the digits.
        self._triangle = np.zeros((count, 3 + self._root.shape[1], 3 + self._root.shape[1]))
        self._frames = np.zeros(count, dtype=np.int64)
        #: Regression of :meth:`_predict_from_holds` up to the last frame; it serves any time that is predicted.
        self._regression: tuple[Array, tuple[Array, Array, Array]] | None = None

    def add(self, time_s: float | Array, values: float | Array, noise: float | Array) -> Self:
        """Add one frame of each hold: times [s], values and their standard deviations, (m,) or common.

        NumericsError if a number is not finite or the noise is not positive.
        """
        shape = self._frames.shape
        time, value, stderr = (
            np.broadcast_to(np.asarray(number, dtype=np.float64), shape) for number in (time_s, values, noise)
        )
        if not (np.isfinite(time).all() and np.isfinite(value).all() and np.isfinite(stderr).all()):
            raise NumericsError("a frame holds a time, a value or a noise that is not a finite number")
        if not (stderr > 0).all():
            raise NumericsError(
                "the noise of a frame is not positive", remedy="give the standard deviation of a value"
            )
        counts = time >= self._kernel.start_s
        row = np.column_stack([self._rows(np.where(counts, time, 0.0)), value]) / stderr[:, None] * counts[:, None]
        self._triangle = _triangle(np.concatenate([self._triangle, row[:, None]], axis=1))
        self._frames += counts
        self._regression = None
        return self

    def predict(
        self,
        *,
        released: float | Array | None = None,
        released_stderr: float | Array = 0.0,
        at_s: float = np.inf,
    ) -> SteadyPrediction:
        """Predict the ends of the holds from frames so far; arguments and errors as for :func:`predict_steady`."""
        if not (self._frames > 0).all():
            raise NumericsError("no frame was seen of a hold", remedy="predict after its first frame")
        if self._kernel.loading != (released is None):
            raise NumericsError(
                f"a kernel of {'loadings' if self._kernel.loading else 'unloadings'} was given"
                f" {'no' if released is None else 'a'} released change"
            )
        if not at_s >= 0:
            raise NumericsError(f"there is no change at {at_s} s", remedy="it is at least 0 after the ramp's end")
        if released is None:
            return self._predict_from_holds(at_s)
        shape = self._frames.shape
        change, stderr = (
            np.broadcast_to(np.asarray(number, dtype=np.float64), shape) for number in (released, released_stderr)
        )
        if not (np.isfinite(change).all() and np.isfinite(stderr).all()):
            raise NumericsError("a released change or its standard error is not a finite number")
        unknown = self._unknown(0.0, change, stderr)
        return self._predict(unknown, change, self._rows(np.full(shape, at_s)), self._regress(unknown, change))

    def _predict_from_holds(self, at_s: float) -> SteadyPrediction:
        """The prior of A w scales with A, so A is predicted iteratively."""
        zeros = np.zeros(self._frames.shape)
        if self._regression is None:
            level = self._triangle[:, :, 0] + self._triangle[:, :, 1]
            size = (level * self._triangle[:, :, -1]).sum(axis=1) / (level**2).sum(axis=1)
            for _ in range(_ROUNDS):
                unknown = self._unknown(1.0, size, zeros)
                regressed = self._regress(unknown, zeros)
                size = regressed[1][:, 0]
            self._regression = unknown, regressed
        unknown, regressed = self._regression
        return self._predict(unknown, zeros, self._rows(np.full(zeros.shape, at_s)), regressed)

    def _rows(self, time_s: Array) -> Array:
        """(m, 2 + 3 k): one, the kernel's transient, and its changes by unit normals of the kernel's uncertainty."""
        if not len(self._kernel.weights):
            return np.concatenate([np.ones((len(time_s), 1)), np.zeros((len(time_s), 1))], axis=1)
        lateness = np.minimum(time_s[:, None] / self._kernel.time_constants_s, _OVER)
        parts = np.where(lateness < _OVER, np.exp(-lateness) * self._share, 0.0)
        weighted = parts * self._kernel.weights
        slopes = np.concatenate([parts, weighted * (lateness - self._slope)], axis=1)
        level = np.ones((len(time_s), 1))
        return np.concatenate([level, weighted.sum(axis=1, keepdims=True), slopes @ self._root], axis=1)

    def _unknown(self, transient: float, size: Array, stderr: Array) -> Array:
        """Contribution of each unknown to the coefficients of the rows, (m, 2 + 3 k, unknowns).

        First the level, which has no prior and scales the transient; then unit normals of the kernel's mean, of its
        scatter, and of the transient's uncertain size.
        """
        count = self._root.shape[1]
        unknown = np.zeros((len(size), 2 + count, 2 + count))
        unknown[:, 0, 0], unknown[:, 1, 0] = 1.0, transient
        indices = np.arange(count)
        unknown[:, 2 + indices, 1 + indices] = size[:, None]
        unknown[:, 1, -1] = stderr
        return unknown

    def _regress(self, unknown: Array, known: Array) -> tuple[Array, Array, Array]:
        """Root L (m, u, u) of the unknowns' covariance L Lᵀ, their values (m, u), and χ² (m,) with their prior's."""
        rows = self._triangle[:, :, :-1] @ unknown
        residual_data = self._triangle[:, :, -1] - known[:, None] * self._triangle[:, :, 1]
        prior = np.broadcast_to(
            np.eye(unknown.shape[2] + 1)[1:-1], (len(rows), unknown.shape[2] - 1, rows.shape[2] + 1)
        )
        augmented = np.concatenate([np.concatenate([rows, residual_data[:, :, None]], axis=2), prior], axis=1)
        triangle = _triangle(augmented)
        root = np.asarray(np.linalg.inv(triangle[:, :-1, :-1]), dtype=np.float64)
        return root, (root @ triangle[:, :-1, -1:])[:, :, 0], triangle[:, -1, -1] ** 2

    def _predict(
        self, unknown: Array, known: Array, wanted: Array, regressed: tuple[Array, Array, Array]
    ) -> SteadyPrediction:
        root, solution, chi_squared = regressed
        wanted_row = (wanted[:, None, :] @ unknown)[:, 0]
        error_parts = (wanted_row[:, None, :] @ root)[:, 0]
        errors = (root @ error_parts[:, :, None])[:, :, 0]
        variance = np.maximum((error_parts**2).sum(axis=1), np.finfo(np.float64).tiny)
        # The error is −errors · (unit normals) + noise; the mean over loads is as uncertain as their scatter.
        scatter = slice(1 + 2 * len(self._kernel.weights), -1)
        scatter_variance = (errors[:, scatter] ** 2).sum(axis=1) * (1 + 1 / self._kernel.loads)
        share = np.clip(scatter_variance / variance, 1e-6, 1.0)
        freedom = self._frames - 1
        return SteadyPrediction(
            (wanted_row * solution).sum(axis=1) + known * wanted[:, 1],
            np.sqrt(variance),
            self._kernel.scatter_freedom / share**2,
            np.where(freedom > 0, chi_squared / np.maximum(freedom, 1), 0.0),
            freedom,
        )


def _triangle(rows: Array) -> Array:
    """Triangular factors (m, u, u) of rows (m, n, u), equivalent to them in least squares."""
    return np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)


def _root(kernel: RelaxationKernel) -> Array:
    """A factor L (2 k, 3 k) of a new load's covariance L Lᵀ; its last k columns are the scatter's."""
    values, vectors = np.linalg.eigh(kernel.covariance)
    scatter_root = np.vstack([np.diag(kernel.scatter), np.zeros((len(kernel.weights),) * 2)])
    return np.concatenate([vectors * np.sqrt(np.maximum(values, 0.0)), scatter_root], axis=1)
