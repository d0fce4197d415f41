"""Uneven response of the sheet."""

from cbsr_qa.domain.scene import SceneSetting, SheetDesign
from cbsr_qa.simulate.fields import places_on, smooth_factor
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.streams import RandomStream


class UnevenResponse:
    """A smooth random factor on the response to strain, drawn once per seed, one on average over the sheet.

    The same strain changes the conductance more here than there.

    Parameters
    ----------
    deviation : standard deviation of the factor over many sheets.
    correlation_mm : length over which it stays alike (of a Gaussian covariance).
    """

    needs: tuple[str, ...] = ()
    perturbs = "sheet"

    def __init__(self, setting: SceneSetting, *, deviation: float, correlation_mm: float) -> None:
        self._deviation = number("deviation", deviation, most=1.0)
        self._correlation_mm = number("correlation_mm", correlation_mm, above=True)
        self._stream = RandomStream(setting.seed, "uneven-response")

    def design(self, design: SheetDesign) -> None:
        """Add the factor to the sheet."""
        design.response.append(
            smooth_factor(
                self._stream,
                deviation=self._deviation,
                correlation_mm=self._correlation_mm,
                over_mm=places_on(design.sensor_type.outline),
            )
        )
