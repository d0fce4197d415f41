"""A thin sheet under a wide head is stiffer than its material."""

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number


class Confinement:
    """A thin sheet that cannot bulge under a wide head is stiffer: all stress is larger by a factor.

    1 + 2 S² with S = r/(2 t) for a bonded layer (Gent & Lindley 1959): 2.3 for 13 mm on 4 mm.

    Parameters
    ----------
    factor : in its place.
    """

    needs: tuple[str, ...] = ("elastic-stress",)
    after: tuple[str, ...] = ("stress-relaxation",)
    perturbs = "stress"

    def __init__(self, setting: SceneSetting, *, factor: float | None = None) -> None:
        shape = setting.indenter.radius_mm / (2 * setting.sensor_type.thickness_mm)
        self._factor = 1 + 2 * shape**2 if factor is None else number("factor", factor, above=True)

    def apply(self, moment: Moment) -> None:
        """Stiffen."""
        moment.stress_kPa = [self._factor * stress for stress in moment.stress_kPa]
