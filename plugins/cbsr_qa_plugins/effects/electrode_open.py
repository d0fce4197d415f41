"""An electrode whose lead is open."""

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate import parameters
from cbsr_qa.simulate.parameters import number
from cbsr_qa_plugins.effects._leads import BESIDE_THE_SHEET, in_series


class ElectrodeOpen:
    """The lead of an electrode is open: its driven pairs carry what the source's limit drives through a leak.

    The other pairs are not affected as long as the voltmeter draws no current: the floating lead then has the
    potential of its contact. What a real input makes of it is ``voltmeter-input``.

    Parameters
    ----------
    electrode : its number.
    resistance_ohm : of the open lead; 1 GΩ is chosen by us (surface leakage of a connector).
    from_s, to_s : when, on the run's time line; by default always.
    """

    needs: tuple[str, ...] = ("source-compliance",)
    after: tuple[str, ...] = BESIDE_THE_SHEET
    perturbs = "impedance"

    def __init__(
        self,
        setting: SceneSetting,
        *,
        electrode: int,
        resistance_ohm: float = 1e9,
        from_s: float = 0.0,
        to_s: float = 1e12,
    ) -> None:
        self._electrode = parameters.electrode("electrode", electrode, setting.sensor_type.electrodes.count)
        self._ohm = number("resistance_ohm", resistance_ohm, above=True, most=1e12)
        self._from_s = number("from_s", from_s)
        self._to_s = number("to_s", to_s, least=self._from_s, above=True)

    def apply(self, moment: Moment) -> None:
        """Open the lead."""
        if self._from_s <= moment.run_s < self._to_s:
            in_series(moment, self._electrode, self._ohm)

    def switches(self, moment: Moment, first_s: float, last_s: float) -> list[float]:
        """When it begins and ends."""
        began_s = moment.setting.began_s
        return [at_s - began_s for at_s in (self._from_s, self._to_s) if first_s < at_s - began_s <= last_s]
