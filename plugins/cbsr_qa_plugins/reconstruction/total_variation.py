"""One-step images of least total variation."""

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.reconstruction import ImagingProblem
from cbsr_qa.reconstruct.options import number, optional_number, whole
from cbsr_qa.reconstruct.total_variation import MOST_STEPS, TOLERANCE, check_alpha
from cbsr_qa.reconstruct.total_variation_choice import choose_alpha
from cbsr_qa.reconstruct.total_variation_images import TotalVariationImages

_NAME = "total-variation"
_MOST_ALLOWED = 1000  # steps; a frame that needs more never ends
_EXACTEST = 1e-7  # duality gap that rounding leaves room for


class TotalVariation:
    """Minimises ½‖W^½(Jx − y)‖² + α∫|∇x| (Borsic et al. 2010) by a primal–dual interior point method.

    For targets with edges. Each frame is a minimisation of its own, a hundred times dearer than a matrix product, and
    weak targets lose contrast: a blob's amplitude is not to be read as a conductance. Runs take linear methods only.

    Parameters
    ----------
    hyperparameter : α itself, in the units of the unit model; else α is chosen once per sensor type by the
        discrepancy principle: the residual of a central target is as large as its noise.
    noise_dB : how far below the mean reading that noise is, where no measured changes say it. A frame that no image
        explains to ten times the noise is refused.
    tolerance : duality gap, of the objective, at which an image counts as the minimiser.
    iterations : allowed a frame, 1 to 1000; fifteen do it. A frame that needs more is refused.
    """

    def __init__(
        self,
        *,
        hyperparameter: float | None = None,
        noise_dB: float = 60.0,
        tolerance: float = TOLERANCE,
        iterations: int = MOST_STEPS,
    ) -> None:
        alpha = optional_number(_NAME, "hyperparameter", hyperparameter)
        tolerance, steps = number(_NAME, "tolerance", tolerance), whole(_NAME, "iterations", iterations)
        if alpha is not None:
            check_alpha(alpha)
        if not _EXACTEST <= tolerance < 1:
            raise NumericsError(
                f"tolerance is {tolerance}; it must be in {_EXACTEST:g} … 1", remedy=f"{TOLERANCE:g} is usual"
            )
        if not 1 <= steps <= _MOST_ALLOWED:
            raise NumericsError(
                f"iterations is {iterations}; it must be 1 to {_MOST_ALLOWED}", remedy=f"{MOST_STEPS} is usual"
            )
        self._alpha, self._noise_dB = alpha, number(_NAME, "noise_dB", noise_dB)
        self._tolerance, self._steps = tolerance, steps

    def prepare(self, problem: ImagingProblem) -> TotalVariationImages:
        """Choose α and prepare the minimisation.

        Raises
        ------
        NumericsError
            If no α leaves a residual of the noise's size.
        """
        chosen = choose_alpha(problem, given=self._alpha, noise_dB=self._noise_dB)
        return TotalVariationImages.of(
            _NAME, problem, chosen.choice, chosen.variance, tolerance=self._tolerance, most_steps=self._steps
        )
