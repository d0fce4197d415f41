"""Error of a force that is told before, or after, the hold of the loads that calibrated. Numpy alone."""

from math import sqrt

import numpy as np

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.relaxation import RelaxationKernel


def kernel_error(kernel: RelaxationKernel, at_s: float, steady_s: float) -> float:
    """Return the relative standard uncertainty of K(steady)/K(at), K(t) = 1 + Σ w e^(−t/τ).

    By the covariance of (w, log τ) and the scatter of the weights from load to load (JCGM 100, 5.2.2).
    """
    slopes = _slopes(kernel, at_s) - _slopes(kernel, steady_s)
    count = len(kernel.weights)
    of_mean = float(slopes @ kernel.covariance @ slopes)
    of_load = float(((slopes[:count] * kernel.scatter) ** 2).sum())
    return sqrt(max(of_mean, 0.0) + of_load)


def _slopes(kernel: RelaxationKernel, time_s: float) -> Array:
    """(2 k,) derivatives of ln K by (w, log τ)."""
    decay = np.exp(-time_s / kernel.time_constants_s)
    by_time_constant = kernel.weights * decay * time_s / kernel.time_constants_s
    slopes: Array = np.concatenate([decay, by_time_constant]) / (1 + float(kernel.weights @ decay))
    return slopes
