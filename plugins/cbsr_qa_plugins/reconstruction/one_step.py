"""One-step Gauss–Newton over consecutive frames, for slow materials.

One-step Gauss–Newton with Tikhonov's prior.

One-step Gauss–Newton with EIDORS's Laplace prior.

One-step Gauss–Newton with the NOSER prior.

One-step Gauss–Newton with a Gaussian high-pass prior.

One-step Gauss–Newton with a smoothness as long as the indenter is wide.
"""

from dataclasses import replace

import numpy as np

from cbsr_qa.domain.results import ImagingProblem, LinearReconstruction
from cbsr_qa.eit.inverse import (
    Correlation,
    OneStep,
    Prior,
    Regularisation,
    RidgeSearch,
    TemporalImages,
    high_pass,
    indenter_smoothness,
    laplace,
    lasting_noise_figure,
    noser,
    number,
    optional_number,
    optional_whole,
    target_radius_mm,
)

_NAME = "gauss-newton-tikhonov"


class GaussNewtonTikhonov:
    """x = (JᵀWJ + λ²I)⁻¹JᵀW y: the smallest image that explains the readings. It moves loads towards the rim.

    Parameters
    ----------
    choose, noise_figure, hyperparameter : how λ is chosen, see
        :class:`~cbsr_qa.eit.inverse.Regularisation`.
    """

    def __init__(
        self, *, choose: str | None = None, noise_figure: float | None = None, hyperparameter: float | None = None
    ) -> None:
        chosen = Regularisation.of(_NAME, choose=choose, noise_figure=noise_figure, given=hyperparameter)
        self._step = OneStep(_NAME, lambda problem: Prior.diagonal(np.ones(len(problem.mesh.elements))), chosen)

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix; NumericsError if λ cannot be chosen or is too small."""
        return self._step.prepare(problem)


_NAME_GAUSS_NEWTON_LAPLACE = "gauss-newton-laplace"


class GaussNewtonLaplace:
    """x = (JᵀWJ + λ²R)⁻¹JᵀW y with R the differences between neighbouring elements (Vauhkonen et al. 1998).

    A constant image costs nothing: how much the sheet changes as a whole is what the readings say, at any λ.

    Parameters
    ----------
    choose, noise_figure, hyperparameter : how λ is chosen, see
        :class:`~cbsr_qa.eit.inverse.Regularisation`.
    """

    def __init__(
        self, *, choose: str | None = None, noise_figure: float | None = None, hyperparameter: float | None = None
    ) -> None:
        chosen = Regularisation.of(
            _NAME_GAUSS_NEWTON_LAPLACE, choose=choose, noise_figure=noise_figure, given=hyperparameter
        )
        self._step = OneStep(_NAME_GAUSS_NEWTON_LAPLACE, lambda problem: laplace(problem.mesh), chosen)

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix; NumericsError if λ cannot be chosen or is too small."""
        return self._step.prepare(problem)


_NAME_GAUSS_NEWTON_NOSER = "gauss-newton-noser"


class GaussNewtonNoser:
    """x = (JᵀWJ + λ²R)⁻¹JᵀW y with R = diag(JᵀJ)^p (Cheney et al. 1990; Adler & Lionheart 2006).

    Parameters
    ----------
    choose, noise_figure, hyperparameter : how λ is chosen, see
        :class:`~cbsr_qa.eit.inverse.Regularisation`. λ is chosen with every reading of the sensor
        type's pattern: a sensor with a bad channel is imaged with the λ of all others, or noise figures of sensors
        could not be compared.
    exponent : p, 0 (Tikhonov, moves images towards the rim) to 1 (moves them inwards). 0.5 is EIDORS's; on the
        100 mm disc at noise figure 1 about 0.25 balances the two and places loads best.
    """

    def __init__(
        self,
        *,
        choose: str | None = None,
        noise_figure: float | None = None,
        hyperparameter: float | None = None,
        exponent: float = 0.5,
    ) -> None:
        chosen = Regularisation.of(
            _NAME_GAUSS_NEWTON_NOSER, choose=choose, noise_figure=noise_figure, given=hyperparameter
        )
        power = number(_NAME_GAUSS_NEWTON_NOSER, "exponent", exponent)
        self._step = OneStep(
            _NAME_GAUSS_NEWTON_NOSER, lambda problem: Prior.diagonal(noser(problem.jacobian, power)), chosen
        )

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix.

        Raises
        ------
        NumericsError
            If λ cannot be chosen or is too small to determine the image, or an element is felt by no reading.
        """
        return self._step.prepare(problem)


_NAME_GAUSS_NEWTON_HIGH_PASS = "gauss-newton-high-pass"


class GaussNewtonHighPass:
    """x = (JᵀWJ + λ²R)⁻¹JᵀW y with R = FᵀF, F a spatial high-pass filter (Adler & Guardo 1996).

    Parameters
    ----------
    choose, noise_figure, hyperparameter : how λ is chosen, see
        :class:`~cbsr_qa.eit.inverse.Regularisation`.
    width : of the low-pass filter that F leaves out, at half height, in units of the sheet's diameter. Adler &
        Guardo's default is a tenth.
    """

    def __init__(
        self,
        *,
        choose: str | None = None,
        noise_figure: float | None = None,
        hyperparameter: float | None = None,
        width: float = 0.1,
    ) -> None:
        chosen = Regularisation.of(
            _NAME_GAUSS_NEWTON_HIGH_PASS, choose=choose, noise_figure=noise_figure, given=hyperparameter
        )
        share = number(_NAME_GAUSS_NEWTON_HIGH_PASS, "width", width)

        def prior_of(problem: ImagingProblem) -> Prior:
            return high_pass(problem.mesh, 2 * share * problem.sensor_type.radius_mm)

        self._step = OneStep(_NAME_GAUSS_NEWTON_HIGH_PASS, prior_of, chosen)

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix; NumericsError if λ cannot be chosen or is too small, or the width is wrong."""
        return self._step.prepare(problem)


_NAME_GAUSS_NEWTON_INDENTER = "gauss-newton-indenter"


class GaussNewtonIndenter:
    """x = PJᵀ (JPJᵀ + λ²W⁻¹)⁻¹ y with P a Matérn covariance whose length is the indenter's radius.

    Parameters
    ----------
    choose, noise_figure, hyperparameter : how λ is chosen, see
        :class:`~cbsr_qa.eit.inverse.Regularisation`.
    indenter_diameter_mm : of the head [mm]; by default 0.13 of the sheet's diameter, the 13 mm of the 100 mm disc.
    """

    def __init__(
        self,
        *,
        choose: str | None = None,
        noise_figure: float | None = None,
        hyperparameter: float | None = None,
        indenter_diameter_mm: float | None = None,
    ) -> None:
        chosen = Regularisation.of(
            _NAME_GAUSS_NEWTON_INDENTER, choose=choose, noise_figure=noise_figure, given=hyperparameter
        )
        given = optional_number(_NAME_GAUSS_NEWTON_INDENTER, "indenter_diameter_mm", indenter_diameter_mm)

        def prior_of(problem: ImagingProblem) -> Prior:
            return indenter_smoothness(problem.mesh, target_radius_mm(problem) if given is None else given / 2)

        self._step = OneStep(_NAME_GAUSS_NEWTON_INDENTER, prior_of, chosen)

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix; NumericsError if λ cannot be chosen or is too small, or the length is wrong."""
        return self._step.prepare(problem)


_NAME_TEMPORAL = "temporal"


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
        :class:`~cbsr_qa.eit.inverse.Regularisation`.
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
            number(_NAME_TEMPORAL, "correlation_frames", correlation_frames),
            optional_whole(_NAME_TEMPORAL, "lag", lag),
        )
        chosen = Regularisation.of(_NAME_TEMPORAL, choose=choose, noise_figure=noise_figure, given=hyperparameter)
        self._diameter_mm = optional_number(_NAME_TEMPORAL, "indenter_diameter_mm", indenter_diameter_mm)
        self._step = OneStep(_NAME_TEMPORAL, self._prior, chosen)

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
        return TemporalImages(_NAME_TEMPORAL, problem, replace(choice, how=how), spectrum, self._correlation)

    def _prior(self, problem: ImagingProblem) -> Prior:
        head_mm = target_radius_mm(problem) if self._diameter_mm is None else self._diameter_mm / 2
        return indenter_smoothness(problem.mesh, head_mm)
