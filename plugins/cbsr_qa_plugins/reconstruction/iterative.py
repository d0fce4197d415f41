"""Methods that iterate on each frame: total variation, and absolute Gauss–Newton with contacts unknown."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from cbsr_qa.eit.inverse.iterative.absolute_images import AbsoluteImages, Expected
from cbsr_qa.eit.inverse.iterative.total_variation import MOST_STEPS, TOLERANCE
from cbsr_qa.eit.inverse.iterative.total_variation_images import TotalVariationImages, choose_alpha
from cbsr_qa.plugin import ImagingProblem, PluginOptions, Problem, WithOptions
from cbsr_qa_plugins.reconstruction._shared import Positive, find_contradictions

_NAME = "total-variation"
_EXACTEST = 1e-7  # duality gap that rounding leaves room for

#: A frame that needs more steps never ends.
Steps = Annotated[int, Field(ge=1, le=1000)]
Decibel = Annotated[float, Field(gt=0, le=200)]
Spread = Annotated[float, Field(ge=1e-6, le=5)]
#: Of the sheet's radius.
Length = Annotated[float, Field(ge=1e-3, le=10)]


class TotalVariation(WithOptions):
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

    class Options(PluginOptions):
        hyperparameter: Positive | None = None
        noise_dB: Decibel = 60.0
        tolerance: Annotated[float, Field(ge=_EXACTEST, lt=1)] = TOLERANCE
        iterations: Steps = MOST_STEPS

    options: Options

    def prepare(self, problem: ImagingProblem) -> TotalVariationImages:
        options = self.options
        choice, variance = choose_alpha(problem, given=options.hyperparameter, noise_dB=options.noise_dB)
        return TotalVariationImages.from_problem(
            _NAME, problem, choice, variance, tolerance=options.tolerance, most_steps=options.iterations
        )


_NAME_ABSOLUTE_GAUSS_NEWTON = "absolute-gauss-newton"


class AbsoluteGaussNewton(WithOptions):
    """Most probable conductance and contact impedances, by iterated Gauss–Newton steps on the complete forward model.

    The unloaded sensor's own readings give its state: an uneven sheet and uneven contacts. Each frame is then found
    from there, with the full non-linear response, and its image is the change against that state. For sheets that
    are far from even, and for changes beyond what a linear image follows. A frame costs some tenths of a second; runs
    take linear methods only.

    Parameters
    ----------
    noise_dB : how far below the mean reading the noise is.
    spread, length : how much ln γ is expected to vary over the unloaded sheet, and over which length, of the radius.
    noise_figure : of the first step on the nominal model (Adler et al. 2009 form), which says how much loads are
        expected to change ln γ; 1.0 unless ``load_spread`` is given.
    load_spread : how much loads are expected to change ln γ; smaller keeps places, larger amplitudes.
    load_length : over which that varies, of the radius; that of the indenter by default.
    contact_spread : how much ln z is expected to vary about the nominal contact impedance; a load is expected to
        change it as much as ln γ.
    mesh_size : edge length of the forward mesh (second order), of the radius, 0.03 to 0.25. At 0.03 a sheet with 16
        pins takes 11 s to prepare, 0.8 s for each step and 0.8 GB.
    iterations : allowed, 1 to 1000; a state that needs more is refused.
    """

    class Options(PluginOptions):
        noise_dB: Decibel = 60.0
        spread: Spread = 0.3
        length: Length = 0.3
        noise_figure: Annotated[float, Field(gt=0, le=100)] | None = None
        load_spread: Spread | None = None
        load_length: Length = 0.13
        contact_spread: Spread = 1.0
        mesh_size: Annotated[float, Field(ge=0.03, le=0.25)] = 0.1
        iterations: Steps = 20

        def problems(self) -> Iterator[Problem]:
            yield from find_contradictions(self, "load_spread", ("noise_figure",))

    absolute = True
    options: Options

    def prepare(self, problem: ImagingProblem) -> AbsoluteImages:
        """Compute the state of the unloaded sensor."""
        settings = self.options.model_dump(exclude={"noise_figure"})
        expected = Expected(noise_figure=self.options.noise_figure or 1.0, **settings)
        return AbsoluteImages.find(_NAME_ABSOLUTE_GAUSS_NEWTON, problem, expected)
