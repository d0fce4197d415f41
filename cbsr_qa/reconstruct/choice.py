"""Choosing the hyperparameter for a noise figure, without knowing any truth."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.reconstruct.dual import DualSpectrum

Array = NDArray[np.float64]

_LOWEST, _HIGHEST = 1e-6, 1e3  # λ searched, relative to the root of the largest eigenvalue


def noise_figure_of(
    spectrum: DualSpectrum, signal: Array, areas: Array, noise_variance: Array | None = None
) -> Callable[[float], float]:
    """Noise figure (Adler et al. 2009) as a function of λ, at a matrix–vector product a call.

    The noise term needs no matrix: Q is orthogonal, so Σ(A R)²v = Σ_k (Σ_e A_e²B_ek²)/(Λ_k + λ²)².
    """
    basis = areas[:, None] * spectrum.basis
    energy = (basis**2).sum(axis=0)
    seen = spectrum.analysis @ signal
    variance = np.ones(len(signal)) if noise_variance is None else noise_variance
    snr = float(np.abs(signal).mean() / np.sqrt(variance.mean()))

    def figure(hyperparameter: float) -> float:
        gain = 1 / (spectrum.values + hyperparameter**2)
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
    unit = float(np.sqrt(spectrum.values[-1]))
    grid = np.linspace(np.log(_LOWEST * unit), np.log(_HIGHEST * unit), 43)
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
