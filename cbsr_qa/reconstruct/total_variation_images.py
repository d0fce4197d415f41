"""Total variation on the readings of a problem, frame by frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.reconstruction import ImagingProblem, ParameterChoice, checked_readings
from cbsr_qa.reconstruct.folding import ReadingFold
from cbsr_qa.reconstruct.total_variation import TotalVariation, TvImage

Array = NDArray[np.float64]

_UNEXPLAINED = 10.0  # residual over noise; loads that double the conductance leave 1.2, a tank's third dimension 5


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
    variance : of the noise α was chosen for, of a reading of unit relative variance; None where nobody said.
    """

    method: str
    problem: ImagingProblem
    choice: ParameterChoice
    readings: WhiteReadings
    minimise: TotalVariation
    variance: float | None = None

    @classmethod
    def of(
        cls,
        method: str,
        problem: ImagingProblem,
        choice: ParameterChoice,
        variance: float | None = None,
        *,
        tolerance: float,
        most_steps: int,
    ) -> "TotalVariationImages":
        """Prepare for a problem; tolerance and steps as of :class:`TotalVariation`."""
        readings = WhiteReadings.of(problem)
        minimise = TotalVariation(problem.mesh, readings.rows, tolerance=tolerance, most_steps=most_steps)
        return cls(method, problem, choice, readings, minimise, variance)

    def images(self, changes: Array) -> Array:
        """Images (n, e) of scaled changes (n, m), each frame by itself.

        Raises
        ------
        RefusedError
            If readings do not fit or are not finite.
        NumericsError
            If a frame does not converge, after how many steps; or if no image explains it to ten times the noise α
            was chosen for: the image that comes nearest would be one of whatever else is in the readings.
        """
        return np.array([one.image for one in self.minimisers(changes)]).reshape(
            len(changes), len(self.problem.mesh.elements)
        )

    def minimisers(self, changes: Array) -> list[TvImage]:
        """Images with their residual, duality gap and number of steps."""
        white = self.readings.white(checked_readings(changes, self.problem))
        found = [self.minimise.image(one, self.choice.value) for one in white]
        if self.variance is not None:
            left = np.sqrt([one.residual / (white.shape[1] * self.variance) for one in found])
            for frame in np.flatnonzero(left > _UNEXPLAINED)[:1]:
                raise NumericsError(
                    f"no image explains frame {frame}: what is left is {left[frame]:.0f} times the noise that was"
                    " expected",
                    remedy="state the noise the readings have (noise_dB), or check geometry and channels",
                )
        return found
