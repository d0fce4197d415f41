"""Relaxation curve of a kernel with its error, to compare a sheet's with that of a strip of its material."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.optimize import brentq

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.relaxation import RelaxationKernel
from cbsr_qa.domain.sensor.sensor_type import MeasuredKernel

#: Number of steps in the search for a settling time.
_STEPS: Final = 2000
#: Share of a standard error for differences.
_SMALL: Final = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class KernelCurve:
    """c + Σ wᵢ e^(−t/τᵢ) with its error: one that :mod:`~cbsr_qa.calibration.fits.agreement` compares.

    Parameters
    ----------
    weights, time_constants_s : (k,) weights and their time constants; weights are relative to the steady (or the
        released) change.
    covariance : (2 k, 2 k) covariance of (w, log τ).
    start_s, window_s : ends of the known time.
    level : c, the final value: 1 after a press, 0 after a release.
    """

    weights: Array
    time_constants_s: Array
    covariance: Array
    start_s: float
    window_s: float
    level: float = 0.0

    @classmethod
    def from_sheet(cls, kernel: RelaxationKernel, start_s: float, window_s: float) -> Self:
        start_s = max(kernel.start_s, start_s)
        level = float(kernel.loading)
        return cls(kernel.weights, kernel.time_constants_s, kernel.covariance, start_s, window_s, level)

    @classmethod
    def from_press(cls, strip: MeasuredKernel) -> Self:
        """Return the expected response of a sheet after a press."""
        weights, time_constants_s = np.array(strip.weights), np.array(strip.time_constants_s)
        return cls(weights, time_constants_s, np.array(strip.covariance), strip.start_s, strip.window_s, 1.0)

    @classmethod
    def from_release(cls, loading: MeasuredKernel, unloading: MeasuredKernel, hold_s: float) -> Self:
        """Return the expected response of a sheet after a hold of given length, over the change at its end.

        A strip's weights are relative to its steady change, which no hold quite reaches, and its creep continues
        after the release (Boltzmann superposition): with w, τ of the press and T the hold, the change at its end is N
        = 1 + Σ w e^(−T/τ) and the decay is (Σ w′ e^(−t/τ′) + Σ w e^(−(T + t)/τ)) / N.
        """
        unloading_count, loading_count = len(unloading.weights), len(loading.weights)
        size = 2 * (unloading_count + loading_count)
        values = np.concatenate(
            [
                unloading.weights,
                np.log(unloading.time_constants_s),
                loading.weights,
                np.log(loading.time_constants_s),
            ]
        )
        covariance = np.zeros((size, size))
        covariance[: 2 * unloading_count, : 2 * unloading_count] = unloading.covariance
        covariance[2 * unloading_count :, 2 * unloading_count :] = loading.covariance

        def convert_release(of: Array) -> Array:
            own_weights, log_own, held_weights, log_held = np.split(
                of, [unloading_count, 2 * unloading_count, 2 * unloading_count + loading_count]
            )
            remaining_weights = held_weights * np.exp(-hold_s / np.exp(log_held))
            return np.concatenate(
                [
                    own_weights / (1 + remaining_weights.sum()),
                    remaining_weights / (1 + remaining_weights.sum()),
                    log_own,
                    log_held,
                ]
            )

        weights_and_logs, jacobian = (
            convert_release(values),
            _jacobian(convert_release, values, np.sqrt(np.diag(covariance))),
        )
        return cls(
            weights_and_logs[: unloading_count + loading_count],
            np.exp(weights_and_logs[unloading_count + loading_count :]),
            jacobian @ covariance @ jacobian.T,
            unloading.start_s,
            unloading.window_s,
        )

    @property
    def why_not(self) -> str:
        """Empty: a kernel can always be compared."""
        return ""

    def relative(self, time_s: Array) -> tuple[Array, Array]:
        """Return the curve and its variance, (n,) each."""
        decays = np.exp(-time_s[:, None] / self.time_constants_s)
        gradient = np.column_stack([decays, decays * self.weights * time_s[:, None] / self.time_constants_s])
        variance: Array = np.einsum("ti,ij,tj->t", gradient, self.covariance, gradient)
        return self.level + decays @ self.weights, np.maximum(variance, 0.0)

    def settling_time(self, tolerance: float) -> tuple[float, float] | None:
        """Return the last time outside ± ``tolerance`` of the change, and its standard error [s]."""
        time_s = np.linspace(self.start_s, self.window_s, _STEPS)
        outside = np.flatnonzero(np.abs(self._evaluate(time_s)) > tolerance)
        if not len(outside) or outside[-1] == _STEPS - 1:
            return None
        sign = np.sign(self._evaluate(time_s[outside[-1] : outside[-1] + 1])[0])
        settled_s = float(
            brentq(
                lambda at: sign * self._evaluate(np.array([at]))[0] - tolerance,
                *time_s[outside[-1] : outside[-1] + 2],
            )
        )
        slope = float((np.exp(-settled_s / self.time_constants_s) * self.weights / self.time_constants_s).sum())
        stderr = float(np.sqrt(self.relative(np.array([settled_s]))[1][0]))
        return (settled_s, stderr / abs(slope)) if slope and stderr else None

    def _evaluate(self, time_s: Array) -> Array:
        return np.exp(-time_s[:, None] / self.time_constants_s) @ self.weights


def _jacobian(function: Callable[[Array], Array], at: Array, stderr: Array) -> Array:
    steps = np.where(stderr > 0, _SMALL * stderr, _SMALL * _SMALL)
    columns = [
        (function(at + step) - function(at - step)) / (2 * step[index]) for index, step in enumerate(np.diag(steps))
    ]
    return np.column_stack(columns)
