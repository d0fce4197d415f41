"""Contacts that are not alike."""

import numpy as np

from cbsr_qa.domain.scene import SceneSetting, SheetDesign
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.streams import RandomStream


class ContactSpread:
    """Contact impedances scatter about a common one: log-normal, independent, drawn once per seed.

    Parameters
    ----------
    deviation : standard deviation over the mean.
    contact_mm : mean impedance over the sheet's resistance; by default the sheet's own.
    """

    needs: tuple[str, ...] = ()
    perturbs = "sheet"

    def __init__(self, setting: SceneSetting, *, deviation: float, contact_mm: float | None = None) -> None:
        self._spread = float(np.sqrt(np.log1p(number("deviation", deviation, most=10.0) ** 2)))
        self._mean_mm = None if contact_mm is None else number("contact_mm", contact_mm, above=True)
        self._stream = RandomStream(setting.seed, "contact-spread")

    def design(self, design: SheetDesign) -> None:
        """Scatter the contacts."""
        factor = np.exp(self._spread * self._stream.normal(0, design.contact_mm.shape) - self._spread**2 / 2)
        mean_mm = design.contact_mm if self._mean_mm is None else self._mean_mm
        design.contact_mm = mean_mm * factor
