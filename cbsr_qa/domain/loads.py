"""What presses on the sheet, where, how hard, and when it happened."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Indenter:
    """Flat round head of the force applicator."""

    diameter_mm: float

    @property
    def radius_mm(self) -> float:
        """Radius r of the head."""
        return self.diameter_mm / 2

    @property
    def area_mm2(self) -> float:
        """Area A_FA of the head (132.7 mm² for 13 mm; the paper rounds to 133)."""
        return float(np.pi * self.radius_mm**2)


@dataclass(frozen=True, slots=True)
class Load:
    """One intended press.

    Parameters
    ----------
    label : ``"L0"`` … ``"L8"`` on the grid, ``"R0"`` … for random loads.
    x_mm, y_mm : centre of the indenter relative to the sheet's centre.
    strain : compressive, as a fraction (0.2 is 20 %).
    trial : 0-based repetition of the same load.
    """

    label: str
    x_mm: float
    y_mm: float
    strain: float
    trial: int


@dataclass(frozen=True, slots=True)
class LoadRecord:
    """One press as it happened, on the run's clock [s].

    Only presses that were held to the end become records: an unfinished one is repeated on resume.

    Parameters
    ----------
    index : 0-based within its phase.
    press_start_s … rest_end_s : the head starts down, is down, starts up, is up, the rest is over.
    clear_s : the head has left the sheet, on its way up; None where nobody noted it (recordings of others).
    """

    index: int
    load: Load
    press_start_s: float
    hold_start_s: float
    release_start_s: float
    release_end_s: float
    rest_end_s: float
    clear_s: float | None = None

    @property
    def unloaded_s(self) -> float:
        """When the unloading ramp ended: the head left the sheet, or is known to be up [s]."""
        return self.release_end_s if self.clear_s is None else self.clear_s


#: The nine locations of the paper's Fig 2, in the rig's order [mm].
NINE_LOCATIONS_MM: tuple[tuple[float, float], ...] = (
    (0.0, 0.0),
    (30.0, 0.0),
    (-30.0, 0.0),
    (15.0, 15.0),
    (-15.0, 15.0),
    (15.0, -15.0),
    (-15.0, -15.0),
    (0.0, 30.0),
    (0.0, -30.0),
)
