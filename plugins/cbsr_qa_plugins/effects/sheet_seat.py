"""How the sheet lies on the station: not quite level, not quite at its nominal height."""

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.streams import RandomStream


class SheetSeat:
    """The sheet lies off nominal in level and tilt: Gaussian, independent, drawn once per seed, fixed for the run.

    Parameters
    ----------
    error_mm : standard deviation of the level, and of what the tilt adds at the sheet's edge along x and along y.
    """

    needs: tuple[str, ...] = ()
    perturbs = "geometry"

    def __init__(self, setting: SceneSetting, *, error_mm: float) -> None:
        deviation_mm = number("error_mm", error_mm)
        level, along_x, along_y = deviation_mm * RandomStream(setting.seed, "sheet-seat").normal(0, (3,))
        radius_mm = setting.sensor_type.radius_mm
        self._level_mm = float(level)
        self._slope = float(along_x) / radius_mm, float(along_y) / radius_mm

    def apply(self, moment: Moment) -> None:
        """Lower (or raise) the surface under the head."""
        x_mm, y_mm = moment.place_mm
        moment.surface_mm += self._level_mm + self._slope[0] * x_mm + self._slope[1] * y_mm
