"""One-step Gauss–Newton over consecutive frames, for slow materials."""

from dataclasses import replace

from cbsr_qa.domain.reconstruction import ImagingProblem
from cbsr_qa.reconstruct.evidence import target_radius_mm
from cbsr_qa.reconstruct.one_step import OneStep, RidgeSearch
from cbsr_qa.reconstruct.options import number, optional_number, optional_whole
from cbsr_qa.reconstruct.priors import Prior
from cbsr_qa.reconstruct.regularisation import Regularisation
from cbsr_qa.reconstruct.smoothness import indenter_smoothness
from cbsr_qa.reconstruct.temporal import Correlation, TemporalImages, lasting_noise_figure

_NAME = "temporal"


class Temporal:
    """Images as of gauss-newton-indenter, alike their neighbours in time (Adler, Dai & Lionheart 2007).

    Images of a block of frames are made together: noise falls where nothing changes, and what changes faster than the
    correlation time is smeared over it. Frames of a block must be evenly spaced, in order and of one recording; a
    block of one frame gives the one-step image. Runs take methods that are one matrix only.

    Parameters
    ----------
    correlation_frames : τ in frames, over which images are expected to stay alike to 1/e. 0 is no expectation, ∞ one
        image for the whole block.
    lag : later frames an image may look at. None for the whole block; 0 for none, as a live display needs: such
        images come late on every change by about the time they average over.
    choose, noise_figure, hyperparameter : how λ is chosen, for a single frame, see
        :class:`~cbsr_qa.reconstruct.regularisation.Regularisation`.
    indenter_diameter_mm : of the head [mm]; by default 0.13 of the sheet's diameter.
    """

    sequences = True

    def __init__(
        self,
        *,
        correlation_frames: float = 4.0,
        lag: int | None = None,
        choose: str | None = None,
        noise_figure: float | None = None,
        hyperparameter: float | None = None,
        indenter_diameter_mm: float | None = None,
    ) -> None:
        self._correlation = Correlation(
            number(_NAME, "correlation_frames", correlation_frames), optional_whole(_NAME, "lag", lag)
        )
        chosen = Regularisation.of(_NAME, choose=choose, noise_figure=noise_figure, given=hyperparameter)
        self._diameter_mm = optional_number(_NAME, "indenter_diameter_mm", indenter_diameter_mm)
        self._step = OneStep(_NAME, self._prior, chosen)

    def prepare(self, problem: ImagingProblem) -> TemporalImages:
        """Choose λ and prepare the spectrum.

        Raises
        ------
        NumericsError
            If λ cannot be chosen or is too small to determine the image, or the diameter is not positive.
        """
        choice = self._step.prepare(problem).choice
        spectrum = RidgeSearch(problem, self._prior(problem)).spectrum
        lasting = lasting_noise_figure(problem, spectrum, choice.value, self._correlation)
        how = f"{choice.how}, for one frame; a change that lasts is imaged with noise figure {lasting:.2f}"
        return TemporalImages(_NAME, problem, replace(choice, how=how), spectrum, self._correlation)

    def _prior(self, problem: ImagingProblem) -> Prior:
        head_mm = target_radius_mm(problem) if self._diameter_mm is None else self._diameter_mm / 2
        return indenter_smoothness(problem.mesh, head_mm)
