"""A sheet that does not lie where the station takes it to be."""

import math

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number


class MisplacedSheet:
    """The disc lies beside its place on the station, and turned: all loads are off alike.

    What the station calls (x, y) is R(−θ) ((x, y) − (x₀, y₀)) on the sheet.

    Parameters
    ----------
    x_mm, y_mm : where on the station the sheet's centre lies.
    rotation_deg : θ, how far it is turned, counterclockwise.
    """

    needs: tuple[str, ...] = ()
    perturbs = "position"

    def __init__(
        self, setting: SceneSetting, *, x_mm: float = 0.0, y_mm: float = 0.0, rotation_deg: float = 0.0
    ) -> None:
        self._x_mm = number("x_mm", x_mm, least=-20.0, most=20.0)
        self._y_mm = number("y_mm", y_mm, least=-20.0, most=20.0)
        turn = math.radians(number("rotation_deg", rotation_deg, least=-180.0, most=180.0))
        self._cos, self._sin = math.cos(turn), math.sin(turn)

    def apply(self, moment: Moment) -> None:
        """Say where on the sheet the head is told to go."""
        x, y = moment.place_mm[0] - self._x_mm, moment.place_mm[1] - self._y_mm
        moment.place_mm = (self._cos * x + self._sin * y, self._cos * y - self._sin * x)
