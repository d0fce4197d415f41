"""Iterative absolute Gauss–Newton with contact impedances unknown."""

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.reconstruction import ImagingProblem
from cbsr_qa.reconstruct.absolute_images import AbsoluteImages, Expected
from cbsr_qa.reconstruct.options import number, optional_number, whole

_NAME = "absolute-gauss-newton"


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
                f"{_NAME} takes noise_figure or load_spread, not both", remedy="leave one of them out"
            )
        self._expected = Expected(
            noise_dB=number(_NAME, "noise_dB", noise_dB),
            spread=number(_NAME, "spread", spread),
            length=number(_NAME, "length", length),
            noise_figure=number(_NAME, "noise_figure", 1.0 if noise_figure is None else noise_figure),
            load_spread=optional_number(_NAME, "load_spread", load_spread),
            load_length=number(_NAME, "load_length", load_length),
            contact_spread=number(_NAME, "contact_spread", contact_spread),
            mesh_size=number(_NAME, "mesh_size", mesh_size),
            iterations=whole(_NAME, "iterations", iterations),
        )

    def prepare(self, problem: ImagingProblem) -> AbsoluteImages:
        """Find the state of the unloaded sensor.

        Raises
        ------
        NumericsError
            If its readings belong to no such sheet, or the iteration does not converge.
        """
        return AbsoluteImages.of(_NAME, problem, self._expected)
