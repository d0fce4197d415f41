"""Smooth random factors by place: what is uneven about a sheet."""

from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.outlines import SheetOutline
from cbsr_qa.domain.scene import SceneSetting, SheetDesign, SheetField
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.streams import RandomStream

Array = NDArray[np.float64]

_LATTICE: Final = 41  # places a side
_WAVES: Final = 400  # their sum is Gaussian to a kurtosis of 3 − 1.5/400


def smooth_factor(stream: RandomStream, *, deviation: float, correlation_mm: float, over_mm: Array) -> SheetField:
    """A positive random factor, one on average over some places.

    The logarithm is a Gaussian field with the covariance s² exp(−d²/2ℓ²), made of waves of random directions, lengths
    and phases (random Fourier features; Rahimi & Recht 2007): a function of place alone, whatever the mesh.

    Parameters
    ----------
    stream : its numbers of index 0 are used.
    deviation : standard deviation of the factor over its mean, before it is divided by what is alike over all places.
    correlation_mm : ℓ.
    over_mm : (n, 2) places, evenly spread over the sheet, whose mean factor is one.
    """
    random = stream.generator(0)
    waves = random.standard_normal((_WAVES, 2)) / correlation_mm
    phases = random.uniform(0, 2 * np.pi, _WAVES)
    spread = float(np.sqrt(np.log1p(deviation**2)))  # of the logarithm, for that deviation of the factor

    def raw(places_mm: Array) -> Array:
        field = np.sqrt(2 / _WAVES) * np.cos(places_mm @ waves.T + phases).sum(axis=1)
        factor: Array = np.exp(spread * field)
        return factor

    mean = float(raw(over_mm).mean())
    return lambda places_mm: raw(places_mm) / mean


def places_on(outline: SheetOutline) -> Array:
    """Places on a square lattice over a sheet, (n, 2) [mm]."""
    low_x, high_x, low_y, high_y = outline.extent_mm
    x, y = (np.linspace(low, high, _LATTICE) for low, high in ((low_x, high_x), (low_y, high_y)))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    on_sheet: Array = places[outline.clearance_mm(places) >= 0]
    return on_sheet


class UnevenSheet:
    """An effect that makes one quantity of the sheet uneven: a smooth random factor, one on average over it.

    Drawn once a seed. Subclasses say which quantity.

    Parameters
    ----------
    deviation : standard deviation of the factor over its mean, as if the sheet went on for ever. What is alike
        all over the sheet is divided out: of 0.1 on a disc of 100 mm 0.088 are left at 20 mm, 0.052 at 60 mm.
    correlation_mm : length over which it stays alike (of a Gaussian covariance).
    """

    #: ``conductance``, ``response`` or ``thickness``
    quantity: ClassVar[str]
    needs: tuple[str, ...] = ()
    perturbs = "sheet"

    def __init__(self, setting: SceneSetting, *, deviation: float, correlation_mm: float) -> None:
        self._deviation = number("deviation", deviation, most=1.0)
        self._correlation_mm = number("correlation_mm", correlation_mm, above=True)
        self._stream = RandomStream(setting.seed, f"uneven-{self.quantity}")

    def design(self, design: SheetDesign) -> None:
        """Add the factor to the sheet."""
        factors: list[SheetField] = getattr(design, self.quantity)
        factors.append(
            smooth_factor(
                self._stream,
                deviation=self._deviation,
                correlation_mm=self._correlation_mm,
                over_mm=places_on(design.sensor_type.outline),
            )
        )
