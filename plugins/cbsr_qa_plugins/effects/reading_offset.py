"""A constant on every reading."""

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number


class ReadingOffset:
    """The converter's zero is off: a constant is on every reading.

    Parameters
    ----------
    offset_V : added to every reading.
    """

    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = ("voltmeter-input",)
    perturbs = "voltages"

    def __init__(self, setting: SceneSetting, *, offset_V: float) -> None:
        self._offset_V = number("offset_V", offset_V, least=-1e3, most=1e3)

    def apply(self, moment: Moment) -> None:
        """Add it."""
        if moment.voltages is not None:
            moment.voltages = moment.voltages + self._offset_V
