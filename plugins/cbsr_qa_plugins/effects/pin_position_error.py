"""Electrodes that are not quite where they should be."""

from cbsr_qa.domain.scene import SceneSetting, SheetDesign
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.streams import RandomStream


class PinPositionError:
    """Every electrode is off by a Gaussian error along x and along y, independent, drawn once per seed.

    Parameters
    ----------
    error_mm : standard deviation along each axis.
    """

    needs: tuple[str, ...] = ()
    perturbs = "sheet"

    def __init__(self, setting: SceneSetting, *, error_mm: float) -> None:
        self._error_mm = number("error_mm", error_mm, most=5.0)
        self._stream = RandomStream(setting.seed, "pin-position-error")

    def design(self, design: SheetDesign) -> None:
        """Move the electrodes."""
        design.shift_mm = design.shift_mm + self._error_mm * self._stream.normal(0, design.shift_mm.shape)
