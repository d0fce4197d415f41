"""Linear back-projection, the historic baseline."""

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.reconstruction import ImagingProblem, LinearReconstruction, ParameterChoice
from cbsr_qa.reconstruct.evidence import central_signal
from cbsr_qa.reconstruct.noise_figure import noise_figure

_NAME = "linear-back-projection"
_LEAST_READING = 1e-6  # of the largest: a reading that the model says is zero has no relative change


class LinearBackProjection:
    """Every element takes the readings' relative changes, weighted by how much it makes of them (Kotre 1989).

    x_e = Σ S_me (y_m/v_m) / √ΣS_me² with S_me = J_me/v_m and v the reference readings: the transposed sensitivity
    in the place of its inverse, the successor of the back-projection along equipotentials of Barber & Brown 1984.
    Kotre divides by Σ|S_me|, which near electrodes that are left out answers a load with the wrong sign.
    Nothing is inverted, so nothing is regularised: images are blurred, and their amplitude is not that of the change.
    It has no options, and does not weigh readings by their noise.
    """

    weighs_noise = False

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix; NumericsError if an element is felt by no reading."""
        reference = problem.reference
        known = np.abs(reference) > _LEAST_READING * np.abs(reference).max()
        relative = np.where(known, 1 / np.where(known, reference, 1.0), 0.0)
        sensitivity = relative[:, None] * problem.jacobian
        felt = np.sqrt(np.einsum("me,me->e", sensitivity, sensitivity))
        if not (felt > 0).all():
            raise NumericsError(
                f"{int((felt <= 0).sum())} image elements are felt by no reading that is left",
                remedy="mend the masked channels",
            )
        matrix = (relative[:, None] * sensitivity).T / felt[:, None]
        areas, variance = problem.mesh.areas_mm2, problem.noise_variance
        figure = noise_figure(matrix, central_signal(problem), areas, noise_variance=variance)
        choice = ParameterChoice(
            0.0, "nothing is regularised, and nothing chosen", figure, "no parameter", criterion="none"
        )
        return LinearReconstruction(_NAME, problem, matrix, choice)
