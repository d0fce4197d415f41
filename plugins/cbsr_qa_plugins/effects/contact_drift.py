"""Contacts that change in the course of a run."""

from typing import Final

import numpy as np

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.streams import RandomStream

_MOST: Final = 50.0  # change of ln z; no sheet can be solved with contacts that far off


class ContactDrift:
    """Every contact impedance grows or falls exponentially at a rate of its own, Gaussian, drawn once per seed.

    Parameters
    ----------
    deviation_per_hour : standard deviation of the change of ln z in an hour.
    """

    needs: tuple[str, ...] = ()
    perturbs = "contacts"

    def __init__(self, setting: SceneSetting, *, deviation_per_hour: float) -> None:
        per_s = number("deviation_per_hour", deviation_per_hour, most=10.0) / 3600
        count = setting.sensor_type.electrodes.count
        self._rate_per_s = per_s * RandomStream(setting.seed, "contact-drift").normal(0, (count,))

    def apply(self, moment: Moment) -> None:
        """Change the contacts by what has passed since the run began."""
        if moment.contact_mm is None:
            return
        grown = self._rate_per_s * moment.run_s
        worst = int(np.abs(grown).argmax())
        if abs(grown[worst]) > _MOST:
            raise RefusedError(
                f"contact-drift makes contact {worst} e^{grown[worst]:.0f} of what it was at {moment.run_s:g} s",
                remedy="take a smaller deviation_per_hour",
            )
        moment.contact_mm = moment.contact_mm * np.exp(grown)
