"""One-step Gauss–Newton with different priors: Tikhonov's, EIDORS's Laplace, NOSER, Gaussian high-pass, indenter.

The last also over consecutive frames, for slow materials.
"""

from dataclasses import replace
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from cbsr_qa.eit.inverse.noise_figures import target_radius_mm
from cbsr_qa.eit.inverse.one_step import ridge_reconstruction
from cbsr_qa.eit.inverse.priors import Prior, high_pass, indenter_smoothness, laplace, noser
from cbsr_qa.eit.inverse.temporal import Correlation, TemporalImages, lasting_noise_figure
from cbsr_qa.plugin import ImagingProblem, LinearReconstruction, PluginOptions, WithOptions
from cbsr_qa_plugins.reconstruction._shared import Positive, RidgeOptions


class _OneStepMethod(WithOptions):
    """A method that is one matrix: subclasses say what its prior is.

    Parameters
    ----------
    choose : criterion for λ; by default noise-figure.
    noise_figure : to be reached by λ, for the criterion of that name; by default 1.
    hyperparameter : λ itself, instead of a criterion.
    """

    Options: ClassVar[type[PluginOptions]] = RidgeOptions
    name: ClassVar[str]
    options: RidgeOptions

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix.

        Raises
        ------
        NumericsError
            If λ cannot be chosen or is too small to determine the image, an element is felt by no reading, or a
            length does not fit the image.
        """
        return ridge_reconstruction(self.name, problem, self.prior, self.options.regularisation())[0]

    def prior(self, problem: ImagingProblem) -> Prior:
        raise NotImplementedError


class GaussNewtonTikhonov(_OneStepMethod):
    """x = (JᵀWJ + λ²I)⁻¹JᵀW y: the smallest image that explains the readings. It moves loads towards the rim."""

    name = "gauss-newton-tikhonov"

    def prior(self, problem: ImagingProblem) -> Prior:
        return Prior.diagonal(np.ones(len(problem.mesh.elements)))


class GaussNewtonLaplace(_OneStepMethod):
    """x = (JᵀWJ + λ²R)⁻¹JᵀW y with R the differences between neighbouring elements (Vauhkonen et al. 1998).

    A constant image costs nothing: how much the sheet changes as a whole is what the readings say, at any λ.
    """

    name = "gauss-newton-laplace"

    def prior(self, problem: ImagingProblem) -> Prior:
        return laplace(problem.mesh)


class GaussNewtonNoser(_OneStepMethod):
    """x = (JᵀWJ + λ²R)⁻¹JᵀW y with R = diag(JᵀJ)^p (Cheney et al. 1990; Adler & Lionheart 2006).

    Parameters
    ----------
    hyperparameter : λ itself, instead of a criterion. λ is chosen with every reading of the sensor
        type's pattern: a sensor with a bad channel is imaged with the λ of all others, or noise figures of sensors
        could not be compared.
    exponent : p, 0 (Tikhonov, moves images towards the rim) to 1 (moves them inwards). 0.5 is EIDORS's; on the
        100 mm disc at noise figure 1 about 0.25 balances the two and places loads best.
    """

    class Options(RidgeOptions):
        exponent: Annotated[float, Field(ge=0, le=1)] = 0.5

    name = "gauss-newton-noser"
    options: Options

    def prior(self, problem: ImagingProblem) -> Prior:
        return Prior.diagonal(noser(problem.jacobian, self.options.exponent))


class GaussNewtonHighPass(_OneStepMethod):
    """x = (JᵀWJ + λ²R)⁻¹JᵀW y with R = FᵀF, F a spatial high-pass filter (Adler & Guardo 1996).

    Parameters
    ----------
    width : of the low-pass filter that F leaves out, at half height, in units of the sheet's diameter. Adler &
        Guardo's default is a tenth.
    """

    class Options(RidgeOptions):
        width: Positive = 0.1

    name = "gauss-newton-high-pass"
    options: Options

    def prior(self, problem: ImagingProblem) -> Prior:
        return high_pass(problem.mesh, 2 * self.options.width * problem.sensor_type.radius_mm)


class _HeadOptions(RidgeOptions):
    indenter_diameter_mm: Positive | None = None


class GaussNewtonIndenter(_OneStepMethod):
    """x = PJᵀ (JPJᵀ + λ²W⁻¹)⁻¹ y with P a Matérn covariance whose length is the indenter's radius.

    Parameters
    ----------
    indenter_diameter_mm : of the head [mm]; by default 0.13 of the sheet's diameter, the 13 mm of the 100 mm disc.
    """

    Options = _HeadOptions
    name = "gauss-newton-indenter"
    options: _HeadOptions

    def prior(self, problem: ImagingProblem) -> Prior:
        return _smooth_over_head(problem, self.options)


def _smooth_over_head(problem: ImagingProblem, options: _HeadOptions) -> Prior:
    given_mm = options.indenter_diameter_mm
    return indenter_smoothness(problem.mesh, target_radius_mm(problem) if given_mm is None else given_mm / 2)


class Temporal(WithOptions):
    """Images as from gauss-newton-indenter, correlated with those before and after (Adler, Dai & Lionheart 2007).

    Images of a block of frames are made together: noise falls where nothing changes, and what changes faster than the
    correlation time is smeared over it. Frames of a block must be evenly spaced, in order and of one recording; a
    block of one frame gives the one-step image. Runs take methods that are one matrix only.

    Parameters
    ----------
    correlation_frames : τ in frames, over which images are expected to stay alike to 1/e. 0 is no expectation, ∞ one
        image for the whole block.
    lag : later frames an image may look at. None for the whole block; 0 for none, as a live display needs: such
        images come late on every change by about the time they average over.
    choose : criterion for λ, of a single frame; by default noise-figure.
    noise_figure : to be reached by λ, for the criterion of that name; by default 1.
    hyperparameter : λ itself, instead of a criterion.
    indenter_diameter_mm : of the head [mm]; by default 0.13 of the sheet's diameter.
    """

    class Options(_HeadOptions):
        correlation_frames: Annotated[float, Field(ge=0, allow_inf_nan=True)] = 4.0
        lag: Annotated[int, Field(ge=0, le=10**15)] | None = None

    name: ClassVar[str] = "temporal"
    sequences = True
    options: Options

    def prepare(self, problem: ImagingProblem) -> TemporalImages:
        options = self.options
        correlation = Correlation(options.correlation_frames, options.lag)
        single, spectrum = ridge_reconstruction(
            self.name, problem, lambda base: _smooth_over_head(base, options), options.regularisation()
        )
        choice = single.choice
        lasting = lasting_noise_figure(problem, spectrum, choice.value, correlation)
        how = f"{choice.how}, for one frame; a change that lasts is imaged with noise figure {lasting:.2f}"
        return TemporalImages(self.name, problem, replace(choice, how=how), spectrum, correlation)
