"""Total variation on the readings of a problem, frame by frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.reconstruction import ImagingProblem, ParameterChoice
from cbsr_qa.reconstruct.checks import checked_changes
from cbsr_qa.reconstruct.folding import ReadingFold
from cbsr_qa.reconstruct.total_variation import TotalVariation, TvImage

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class WhiteReadings:
    """Readings of a problem, folded by reciprocity and with equal noise on all.

    Parameters
    ----------
    fold : which readings are the same.
    deviation : (g,) of the folded readings, relative.
    rows : (g, e), the Jacobian of white readings.
    """

    fold: ReadingFold
    deviation: Array
    rows: Array

    @classmethod
    def of(cls, problem: ImagingProblem) -> "WhiteReadings":
        """Whiten a problem."""
        fold = ReadingFold.of(problem)
        deviation = np.sqrt(fold.variance)
        return cls(fold, deviation, fold.rows(problem.jacobian) / deviation[:, None])

    def white(self, changes: Array) -> Array:
        """White readings (n, g) of changes (n, m)."""
        white: Array = self.fold.fold(changes) / self.deviation
        return white


@dataclass(frozen=True, slots=True, eq=False)
class TotalVariationImages:
    """A prepared method, see :class:`~cbsr_qa.domain.reconstruction.PreparedReconstruction`.

    Parameters
    ----------
    choice : of α.
    minimise : prepared for the problem's mesh and readings.
    """

    method: str
    problem: ImagingProblem
    choice: ParameterChoice
    readings: WhiteReadings
    minimise: TotalVariation

    @classmethod
    def of(
        cls, method: str, problem: ImagingProblem, choice: ParameterChoice, *, tolerance: float, most_steps: int
    ) -> "TotalVariationImages":
        """Prepare for a problem; parameters as of :class:`TotalVariation`."""
        readings = WhiteReadings.of(problem)
        minimise = TotalVariation(problem.mesh, readings.rows, tolerance=tolerance, most_steps=most_steps)
        return cls(method, problem, choice, readings, minimise)

    def images(self, changes: Array) -> Array:
        """Images (n, e) of scaled changes (n, m), each frame by itself.

        Raises
        ------
        RefusedError
            If readings do not fit or are not finite.
        NumericsError
            If a frame does not converge; says after how many steps, and what helps.
        """
        return np.array([one.image for one in self.minimisers(changes)]).reshape(len(changes), -1)

    def minimisers(self, changes: Array) -> list[TvImage]:
        """Images with their residual, duality gap and number of steps."""
        white = self.readings.white(checked_changes(changes, self.problem))
        return [self.minimise.image(one, self.choice.value) for one in white]
