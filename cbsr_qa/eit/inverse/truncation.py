"""Truncated singular value decomposition of W^½J, with no other regularisation.

On a symmetric sheet singular values come in pairs: cuts are made between values that differ by more than the mesh's
asymmetry explains.
"""

from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.eit.inverse.dual import DualSpectrum, dual_spectrum
from cbsr_qa.eit.inverse.noise_figures import Evidence, central_signal
from cbsr_qa.eit.inverse.one_step import noise_level
from cbsr_qa.eit.inverse.readings import ReadingFold
from cbsr_qa.eit.inverse.regularisation import Criterion

_PAIR: Final = 0.98  # singular values within this ratio are kept or dropped together
_LEAST: Final = 1e-7  # of the largest: measurements do not have seven digits
_WIDEST: Final = np.cos(7 / 8 * np.pi)  # of the angle at a corner
_REMEDY: Final = "choose by noise figure, or give the number of components itself"


class Truncation:
    """A problem's singular values and vectors, the largest first.

    Parameters
    ----------
    problem : problem whose readings are folded first.
    """

    def __init__(self, problem: ImagingProblem) -> None:
        self._fold = ReadingFold.from_problem(problem)
        rows = self._fold.rows(problem.jacobian)
        spectrum = dual_spectrum(rows, problem.mesh.areas_mm2, self._fold.variance)
        kept_components = np.flatnonzero(spectrum.values > _LEAST**2 * spectrum.values[-1])[::-1]
        self._values = spectrum.values[kept_components]
        self._spectrum = DualSpectrum(
            spectrum.basis[:, kept_components], self._values, spectrum.analysis[kept_components]
        )
        self._problem = problem

    @property
    def cuts(self) -> Indices:
        """Numbers of components that split no pair, rising."""
        roots = np.sqrt(self._values)
        is_cut = np.append(roots[1:] < _PAIR * roots[:-1], True)
        return np.flatnonzero(is_cut).astype(np.int64) + 1

    @property
    def shown(self) -> Array:
        """The same, as parameter values."""
        return self.cuts.astype(np.float64)

    @property
    def discrete(self) -> bool:
        """True: components are counted."""
        return True

    def count_components(self, target: float) -> int:
        """Most components whose noise figure is at most a target, for a problem other than the type's nominal one.

        Noise is that of the quiet readings (harmonic mean of the variances).

        NumericsError if even the fewest components have a larger one, which it names.
        """
        variance = self._problem.noise_variance
        louder = 1.0 if variance is None else float(np.sqrt(variance.mean() * (1 / variance).mean()))
        figures = louder * self.noise_figures(self.shown)
        allowed = np.flatnonzero(figures <= target)
        if not allowed.size:
            raise NumericsError(
                f"no number of components reaches noise figure {target:.3g} with the remaining readings; the"
                f" least is {figures.min():.3g}",
                remedy="give a larger noise figure or the number of components itself, or repair bad channels",
            )
        return int(self.cuts[allowed[-1]])

    def matrix(self, components: int) -> Array:
        """Imaging matrix (e, m); NumericsError for too many components, or if a pair would be split."""
        if components not in self.cuts:
            nearest_cuts = self.cuts[np.argsort(np.abs(self.cuts - components), kind="stable")[:2]]
            count = len(self._values)
            raise NumericsError(
                f"components is {components}; allowed: 1 to {count}"
                if not 1 <= components <= count
                else f"{components} components split a pair of equal singular values",
                remedy=f"keep {' or '.join(str(number) for number in sorted(nearest_cuts))}",
            )
        kept_components = slice(None, components)
        images = self._spectrum.basis[:, kept_components] / self._values[kept_components]
        return self._fold.unfold(images @ self._spectrum.analysis[kept_components])

    def noise_figures(self, values: Array) -> Array:
        """Noise figure (Adler et al. 2009) of each of some numbers of components."""
        areas, variance = self._problem.mesh.areas_mm2, self._problem.noise_variance
        signal = central_signal(self._problem)
        snr = np.abs(signal).mean() / np.sqrt(1.0 if variance is None else variance.mean())
        weighted = areas[:, None] * self._spectrum.basis / self._values
        noise = np.sqrt(np.cumsum((weighted**2).sum(axis=0)) / len(areas))
        image = np.cumsum(weighted * (self._spectrum.analysis @ self._fold.fold(signal[None])[0]), axis=1)
        figures: Array = snr * noise / np.abs(image).mean(axis=0)
        return figures[values.astype(np.int64) - 1]

    def for_noise_figure(self, target: float) -> float:
        """Most components whose noise figure is at most the target."""
        figures = self.noise_figures(self.shown)
        allowed = np.flatnonzero(figures <= target)
        if not allowed.size or not target <= figures.max():
            raise NumericsError(
                f"noise figure {target} cannot be reached; this sensor type allows {figures.min():.3g} to"
                f" {figures.max():.3g}",
                remedy="give a noise figure in that range, or the number of components itself",
            )
        return float(self.shown[allowed[-1]])

    def choose_from_readings(self, criterion: Criterion, evidence: Evidence) -> float:
        """Number of components chosen from readings; NumericsError if they determine none."""
        energy = ((self._fold.fold(evidence.changes) @ self._spectrum.analysis.T) ** 2).sum(axis=0)
        if not energy.any():
            raise NumericsError(
                "the readings to choose from do not differ from their reference: nothing to fit",
                remedy="choose by noise figure, or on readings of a load",
            )
        residuals = np.append(np.cumsum(energy[::-1])[::-1], 0.0)[self.cuts]
        if criterion is Criterion.GCV:
            return self._cross_validated(residuals)
        if criterion is Criterion.DISCREPANCY:
            return self._discrepant(residuals, noise_level(evidence, len(self._fold.first)))
        return self._find_corner(residuals, np.cumsum(energy / self._values)[self.cuts - 1])

    def _cross_validated(self, left: Array) -> float:
        free = len(self._values) - self.cuts
        has_freedom = free > 0
        minimum = int(np.argmin(left[has_freedom] / free[has_freedom] ** 2))
        if minimum in (0, int(has_freedom.sum()) - 1):
            raise NumericsError(f"cross-validation has no minimum within 1 to {len(free)} components", remedy=_REMEDY)
        return float(self.cuts[minimum])

    def _discrepant(self, left: Array, level: float) -> float:
        """Fewest components with a residual no larger than noise."""
        enough = np.flatnonzero(left <= level)
        if not enough.size or enough[0] == 0 or level <= 0:
            raise NumericsError(
                "the discrepancy principle has no answer: the readings are"
                f" {'no larger than' if enough.size and level > 0 else 'not explained down to'} their noise",
                remedy=_REMEDY,
            )
        return float(self.cuts[enough[0]])

    def _find_corner(self, left: Array, size: Array) -> float:
        """Corner of the discrete L-curve by the triangle method (Castellanos, Gómez & Guerra 2002)."""
        is_resolved = left > _LEAST**2 * left[0]
        points = np.column_stack([np.log(left[is_resolved]), np.log(size[is_resolved])]) / 2
        best, corner = _WIDEST, -1
        for middle in range(1, len(points) - 1):
            back, ahead = points[:middle] - points[middle], points[-1] - points[middle]
            cosine = back @ ahead / (np.hypot(*back.T) * np.hypot(*ahead))
            towards_origin = back[:, 0] * ahead[1] - back[:, 1] * ahead[0] > 0
            sharpest = float(np.where(towards_origin, cosine, -np.inf).max())
            if sharpest > best:
                best, corner = sharpest, middle
        if corner < 0:
            raise NumericsError("the L-curve of the components has no corner", remedy=_REMEDY)
        return float(self.cuts[is_resolved][corner])
