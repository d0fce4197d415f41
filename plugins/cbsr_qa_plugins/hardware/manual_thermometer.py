"""A thermometer that an operator reads."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from cbsr_qa.domain.frames import SampleBlock
from cbsr_qa.domain.run import InstrumentIdentity
from cbsr_qa.interfaces import Instrument, StationContext
from cbsr_qa_plugins.hardware._by_hand import Operator, hand_moved
from cbsr_qa_plugins.hardware._options import InstrumentTable

_DRIVER: Final = "manual-thermometer"
_KEYS: Final = ("label", "number", "every_min")
#: A limited temperature may be five minutes old; a question takes its time.
_LIMITED_MIN, _UNLIMITED_MIN = 3.0, 30.0
_COLDEST_C, _HOTTEST_C = -40.0, 100.0


def open_thermometer(context: StationContext) -> "ManualThermometer":
    """Open a thermometer that is read by an operator; it samples ``temperature`` [°C].

    Options of its table: ``label`` and ``number``, for the record; ``every_min`` (how often it is asked for; by
    default every 3 minutes where the station limits the temperature, else every 30).

    Raises
    ------
    ConfigError
        If an option is wrong, or there is no operator to be asked.
    """
    return ManualThermometer(context)


class ManualThermometer:
    """Asks for a reading whenever the last one has become too old."""

    channel = "temperature"
    unit = "°C"

    def __init__(self, context: StationContext) -> None:
        table = InstrumentTable(context, _DRIVER, _KEYS)
        self._role, self._clock = context.role, context.clock
        self._operator = Operator(context, _DRIVER)
        self._label = table.text("label", "thermometer read by hand")
        self._number = table.text("number") if table.has("number") else ""
        limited = context.safety is not None and context.safety.temperature_C is not None
        every_min = table.number("every_min", _LIMITED_MIN if limited else _UNLIMITED_MIN, at_least=0.1)
        self._every_s = 60.0 * every_min
        self._last: tuple[float, float] | None = None

    # --- instrument ---

    def identity(self) -> InstrumentIdentity:
        """Say what the table says: it cannot be asked."""
        return InstrumentIdentity(self._role, _DRIVER, self._label, self._number, "", simulated=False)

    def safe_state(self) -> None:
        """Do nothing: a thermometer harms nobody."""

    def close(self) -> None:
        """Do nothing."""

    def link(self, peers: Mapping[str, Instrument]) -> None:
        """See that the head is one that waits for the operator as well; ConfigError where it moves by itself."""
        hand_moved(peers, "a thermometer")

    # --- sampler ---

    def samples_since(self, time_s: float) -> SampleBlock:
        """Return the last reading if it is younger than a time, after asking for one that is due."""
        if self._last is None or self._clock.now() - self._last[0] >= self._every_s:
            celsius = self._operator.number("read the thermometer", self.unit, least=_COLDEST_C, most=_HOTTEST_C)
            self._last = (self._clock.now(), celsius)
        new = [one for one in (self._last,) if one[0] > time_s]
        times, values = np.array(new, dtype=np.float64).reshape(-1, 2).T
        return SampleBlock(self.channel, self.unit, times, values)
