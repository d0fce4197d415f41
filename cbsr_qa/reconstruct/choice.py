"""Choosing the hyperparameter for a noise figure, without knowing any truth."""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.reconstruct.dual import DualSpectrum

Array = NDArray[np.float64]

_LOWEST, _HIGHEST = 1e-6, 1e3  # λ searched, relative to the root of the largest eigenvalue
_STEPS: Final = 43


def noise_figure_of(
    spectrum: DualSpectrum, signal: Array, areas: Array, noise_variance: Array | None = None
) -> Callable[[float], float]:
    """Noise figure (Adler et al. 2009) as a function of λ, at a matrix–vector product a call.

    The noise term needs no matrix: the rows of the analysis have unit variance and no covariance, so
    Σ(A R)²v = Σ_k (Σ_e A_e²B_ek²) g_k².
    """
    basis = areas[:, None] * spectrum.basis
    energy = (basis**2).sum(axis=0)
    seen = spectrum.analysis @ signal
    variance = np.ones(len(signal)) if noise_variance is None else noise_variance
    snr = float(np.abs(signal).mean() / np.sqrt(variance.mean()))

    def figure(hyperparameter: float) -> float:
        gain = spectrum.gains(hyperparameter)
        noise = np.sqrt((energy * gain**2).sum() / len(areas))
        return snr * float(noise / np.abs(basis @ (gain * seen)).mean())

    return figure


def hyperparameter_for(
    target: float, spectrum: DualSpectrum, signal: Array, areas: Array, noise_variance: Array | None = None
) -> float:
    """Find λ, to ten digits, whose noise figure is the target.

    Raises
    ------
    NumericsError
        If no λ reaches the target; says the range that can be reached.
    """
    figure = noise_figure_of(spectrum, signal, areas, noise_variance)
    grid = np.log(searched(spectrum))
    reached = np.array([figure(float(np.exp(at))) for at in grid])
    if not (np.isfinite(target) and reached.min() <= target <= reached.max()):
        raise NumericsError(
            f"noise figure {target} cannot be reached;"
            f" this sensor type allows {reached.min():.3g} to {reached.max():.3g}",
            remedy="ask for a noise figure in that range, or give the hyperparameter itself",
        )
    # The noise figure falls with λ but for wiggles at the ends; the largest λ that reaches the target is smoothest.
    last = np.flatnonzero((reached[:-1] >= target) & (target >= reached[1:]))[-1]
    root = brentq(lambda at: np.log(figure(float(np.exp(at))) / target), grid[last], grid[last + 1], xtol=1e-12)
    return float(f"{np.exp(root):.10g}")  # digits beyond these depend on how many threads the linear algebra has


def searched(spectrum: DualSpectrum) -> Array:
    """Values of λ among which one is looked for, rising."""
    unit = float(np.sqrt(spectrum.values[-1]))
    return np.geomspace(_LOWEST * unit, _HIGHEST * unit, _STEPS)
