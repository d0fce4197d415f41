"""GREIT's imaging matrix: of a λ, and the λ of a noise figure. What was made last is kept."""

from collections import OrderedDict
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.reconstruction import ImagingProblem
from cbsr_qa.reconstruct.greit import GreitRows
from cbsr_qa.reconstruct.greit_calibration import Calibration
from cbsr_qa.reconstruct.greit_targets import TargetDesign

Array = NDArray[np.float64]

_LOWEST, _HIGHEST = (
    1e-4,
    0.6,
)  # λ searched, noise over signal of a reading: above, masks of targets lose their targets
_TYPICAL: Final = (0.05, 0.3)  # searched first
_WIDER: Final = 4.0  # each time the noise figure is not between them
_REACHED: Final = 1e-3  # in ln λ; half of that or less in the noise figure
_KEPT: Final = 6  # problems
_MATRICES: Final = 2  # of each, 3.4 MB on the usual mesh


@dataclass(frozen=True, eq=False)
class GreitMatrix:
    """What comes of one λ.

    Parameters
    ----------
    values : (e, m) float64, read only.
    noise_figure : Adler et al. 2009, with equal noise on all readings.
    """

    values: Array
    noise_figure: float


def greit_matrix(problem: ImagingProblem, design: TargetDesign, hyperparameter: float) -> GreitMatrix:
    """Make the imaging matrix of a λ, rms noise over rms signal of a reading.

    Raises
    ------
    NumericsError
        If λ is negative, not finite, or too small to determine the image; or a target is felt by no reading.
    """
    kept = _kept(problem, design)
    return kept.matrices.get(hyperparameter) or _Search(problem, design, kept).at(hyperparameter)


@dataclass(frozen=True, eq=False)
class GreitChoice:
    """The λ of a noise figure, and what was looked at on the way: the same whatever was searched before.

    Parameters
    ----------
    value : λ.
    searched, noise_figures : (k,) float64, λ rising and the noise figure of each; ``value`` is among them.
    """

    value: float
    searched: Array
    noise_figures: Array


def hyperparameter_for(problem: ImagingProblem, design: TargetDesign, noise_figure: float) -> GreitChoice:
    """Find the λ whose matrix has a noise figure, to 1 in 1000.

    Raises
    ------
    NumericsError
        If there is none; says the range that can be reached.
    """
    kept = _kept(problem, design)
    if noise_figure not in kept.chosen:
        kept.chosen[noise_figure] = _Search(problem, design, kept).for_noise_figure(noise_figure)
    return kept.chosen[noise_figure]


@dataclass(frozen=True, eq=False)
class _Kept:
    matrices: OrderedDict[float, GreitMatrix] = field(default_factory=OrderedDict)
    chosen: dict[float, GreitChoice] = field(default_factory=dict)


_PROBLEMS: Final[OrderedDict[tuple[bytes, TargetDesign], _Kept]] = OrderedDict()


def _kept(problem: ImagingProblem, design: TargetDesign) -> _Kept:
    """What is kept of problems with the same numbers."""
    variance = problem.noise_variance
    digest = blake2b(problem.used.tobytes())
    for values in (problem.mesh.nodes_mm, problem.jacobian, problem.reference):
        digest.update(np.ascontiguousarray(values).tobytes())
    digest.update(b"" if variance is None else variance.tobytes())
    key = digest.digest(), design
    kept = _PROBLEMS.setdefault(key, _Kept())
    _PROBLEMS.move_to_end(key)
    while len(_PROBLEMS) > _KEPT:
        _PROBLEMS.popitem(last=False)
    return kept


class _Search:
    def __init__(self, problem: ImagingProblem, design: TargetDesign, kept: _Kept) -> None:
        self._fits, self._kept = GreitRows(problem, design), kept
        self._calibration = Calibration(self._fits)
        self._seen: dict[float, float] = {}

    def at(self, hyperparameter: float) -> GreitMatrix:
        """Return the matrix of a λ."""
        matrices = self._kept.matrices
        if hyperparameter not in matrices:
            values = self._fits.matrix(self._calibration.rows(hyperparameter))
            values.flags.writeable = False  # shared by everybody who asks
            matrices[hyperparameter] = GreitMatrix(values, self._fits.noise_figure(values))
            while len(matrices) > _MATRICES:
                matrices.popitem(last=False)
        matrices.move_to_end(hyperparameter)
        return matrices[hyperparameter]

    def for_noise_figure(self, target: float) -> GreitChoice:
        """λ of a noise figure."""
        self._seen = {}
        ends = self._ends(target) if np.isfinite(target) and target > 0 else None
        if ends is None:
            reached = [self._figure(value) for value in (_HIGHEST, _LOWEST)]
            raise NumericsError(
                f"noise figure {target} cannot be reached by greit; this problem allows"
                f" {reached[0]:.3g} to {reached[1]:.3g}",
                remedy="ask for a noise figure in that range, or give the hyperparameter itself",
            )

        low, high = (float(np.log(end)) for end in ends)
        exactly = dict(zip((low, high), ends, strict=True))  # e^(ln λ) is not λ to the last digit, hence another fit

        def over(at: float) -> float:
            return float(np.log(self._figure(exactly.get(at, float(np.exp(at)))) / target))

        root = float(brentq(over, low, high, xtol=_REACHED))
        value = exactly.get(root, float(np.exp(root)))
        self._seen[value] = self.at(value).noise_figure  # and its matrix is kept
        searched = np.array(sorted(self._seen))
        return GreitChoice(value, searched, np.array([self._seen[each] for each in searched]))

    def _figure(self, hyperparameter: float) -> float:
        """Noise figure of a λ, which is remembered for the search."""
        if hyperparameter not in self._seen:
            self._seen[hyperparameter] = self.at(hyperparameter).noise_figure
        return self._seen[hyperparameter]

    def _ends(self, target: float) -> tuple[float, float] | None:
        """Two λ between whose noise figures the target lies; None where there are none."""
        low, high = _TYPICAL
        while self._figure(low) < target:
            if low == _LOWEST:
                return None
            low = max(low / _WIDER, _LOWEST)
        if self._figure(high) > target:
            high = _HIGHEST
        return (low, high) if self._figure(high) <= target else None
