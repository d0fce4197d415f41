"""Iterative absolute Gauss–Newton with contact impedances unknown.

One-step images of least total variation.
"""

from cbsr_qa.domain import NumericsError
from cbsr_qa.domain.results import ImagingProblem
from cbsr_qa.eit.inverse import number, optional_number, whole
from cbsr_qa.eit.inverse.iterative import (
    MOST_STEPS,
    TOLERANCE,
    AbsoluteImages,
    Expected,
    TotalVariationImages,
    check_alpha,
    choose_alpha,
)

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
        choice, variance = choose_alpha(problem, given=self._alpha, noise_dB=self._noise_dB)
        return TotalVariationImages.of(
            _NAME, problem, choice, variance, tolerance=self._tolerance, most_steps=self._steps
        )


_NAME_ABSOLUTE_GAUSS_NEWTON = "absolute-gauss-newton"


class AbsoluteGaussNewton:
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
        expected to change ln γ; 1.0 unless that is given as
    load_spread : smaller keeps places, larger amplitudes. load_length : over which it varies, of the radius; that of
        the indenter by default.
    contact_spread : how much ln z is expected to vary about the nominal contact impedance; a load is expected to
        change it as much as ln γ.
    mesh_size : edge length of the forward mesh (second order), of the radius, 0.03 to 0.25. At 0.03 a sheet with 16
        pins takes 11 s to prepare, 0.8 s for each step and 0.8 GB.
    iterations : allowed, 1 to 1000; a state that needs more is refused.
    """

    absolute = True

    def __init__(
        self,
        *,
        noise_dB: float = 60.0,
        spread: float = 0.3,
        length: float = 0.3,
        noise_figure: float | None = None,
        load_spread: float | None = None,
        load_length: float = 0.13,
        contact_spread: float = 1.0,
        mesh_size: float = 0.1,
        iterations: int = 20,
    ) -> None:
        if noise_figure is not None and load_spread is not None:
            raise NumericsError(
                f"{_NAME_ABSOLUTE_GAUSS_NEWTON} takes noise_figure or load_spread, not both",
                remedy="leave one of them out",
            )
        self._expected = Expected(
            noise_dB=number(_NAME_ABSOLUTE_GAUSS_NEWTON, "noise_dB", noise_dB),
            spread=number(_NAME_ABSOLUTE_GAUSS_NEWTON, "spread", spread),
            length=number(_NAME_ABSOLUTE_GAUSS_NEWTON, "length", length),
            noise_figure=number(
                _NAME_ABSOLUTE_GAUSS_NEWTON, "noise_figure", 1.0 if noise_figure is None else noise_figure
            ),
            load_spread=optional_number(_NAME_ABSOLUTE_GAUSS_NEWTON, "load_spread", load_spread),
            load_length=number(_NAME_ABSOLUTE_GAUSS_NEWTON, "load_length", load_length),
            contact_spread=number(_NAME_ABSOLUTE_GAUSS_NEWTON, "contact_spread", contact_spread),
            mesh_size=number(_NAME_ABSOLUTE_GAUSS_NEWTON, "mesh_size", mesh_size),
            iterations=whole(_NAME_ABSOLUTE_GAUSS_NEWTON, "iterations", iterations),
        )

    def prepare(self, problem: ImagingProblem) -> AbsoluteImages:
        """Find the state of the unloaded sensor.

        Raises
        ------
        NumericsError
            If its readings belong to no such sheet, or the iteration does not converge.
        """
        return AbsoluteImages.of(_NAME_ABSOLUTE_GAUSS_NEWTON, problem, self._expected)
