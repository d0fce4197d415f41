"""A load cell or scale that an operator reads."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from cbsr_qa.domain.frames import SampleBlock
from cbsr_qa.domain.run import InstrumentIdentity
from cbsr_qa.interfaces import Instrument, StationContext
from cbsr_qa_plugins.hardware._by_hand import HandMoved, Operator, hand_moved
from cbsr_qa_plugins.hardware._options import InstrumentTable

_DRIVER: Final = "manual-load-cell"
_KEYS: Final = ("label", "number", "unit", "capacity", "tare")
_GRAVITY: Final = 9.80665  # standard gravity [m/s²]
_NEWTONS: Final[Mapping[str, float]] = {"N": 1.0, "g": 1e-3 * _GRAVITY, "kg": _GRAVITY}
#: How long a reading counts where the station says nothing [s].
_COUNTS_S: Final = 2.0


def open_load_cell(context: StationContext) -> "ManualLoadCell":
    """Open a load cell that is read by an operator.

    Options of its table: ``label`` and ``number``, for the record; ``unit`` it shows (``"N"``, ``"g"`` or ``"kg"``,
    compression positive); ``capacity`` in that unit (no reading can be larger); ``tare`` (whether what it shows with
    the head up is asked for once and taken off; default true).

    Raises
    ------
    ConfigError
        If an option is missing or wrong, or there is no operator to be asked.
    """
    return ManualLoadCell(context)


class ManualLoadCell:
    """Asks for a reading whenever one is due, and samples nothing in between.

    One is due once the head was told to go anywhere, and, while the head is down, as soon as half the time has passed
    for which the station lets a force count (``stale_s``). The station's rule on stale force holds as for any load
    cell: a station that is worked by hand allows a minute or two, and in a longer hold the force is read again.
    """

    channel = "force"
    unit = "N"

    def __init__(self, context: StationContext) -> None:
        table = InstrumentTable(context, _DRIVER, _KEYS)
        self._role, self._clock = context.role, context.clock
        self._operator = Operator(context, _DRIVER)
        self._model = table.text("label", "load cell read by hand")
        self._serial = table.text("number") if table.has("number") else ""
        self._shown = table.choice("unit", tuple(_NEWTONS))
        self._most = table.number("capacity", at_least=1e-6)
        self._tare: float | None = None if table.flag("tare", True) else 0.0
        self._again_s = (context.safety.stale_s if context.safety is not None else _COUNTS_S) / 2
        self._head: HandMoved | None = None
        self._orders = -1
        self._last: tuple[float, float] | None = None

    # --- instrument ---

    def identity(self) -> InstrumentIdentity:
        """Say what the table says: it cannot be asked."""
        return InstrumentIdentity(self._role, _DRIVER, self._model, self._serial, "", simulated=False)

    def safe_state(self) -> None:
        """Do nothing: a load cell harms nobody."""

    def close(self) -> None:
        """Do nothing."""

    def link(self, peers: Mapping[str, Instrument]) -> None:
        """Be given the head.

        Raises
        ------
        ConfigError
            If the head moves by itself: it would press on while somebody looks for the display.
        """
        self._head = hand_moved(peers, "a load cell")

    # --- sampler ---

    def samples_since(self, time_s: float) -> SampleBlock:
        """Return the last reading if it is younger than a time, after asking for one that is due."""
        if self._due():
            self._read()
        new = [one for one in (self._last,) if one is not None and one[0] > time_s]
        times, values = np.array(new, dtype=np.float64).reshape(-1, 2).T
        return SampleBlock(self.channel, self.unit, times, values)

    def _due(self) -> bool:
        if self._head is None or self._last is None or self._head.orders != self._orders:
            return True
        return self._head.down and self._clock.now() - self._last[0] > self._again_s

    def _read(self) -> None:
        """Ask for the tare if it is not known yet, then for a reading."""
        down = self._head is not None and self._head.down
        orders = -1 if self._head is None else self._head.orders
        if self._tare is None and not down:
            self._tare = self._asked("with the head up and nothing on it, read the load cell (its tare)")
            shown = self._tare
        else:
            shown = self._asked(f"read the load cell, the head is {'down' if down else 'up'}")
        newtons = (shown - (self._tare or 0.0)) * _NEWTONS[self._shown]
        # Orders given meanwhile would make this reading one of another depth; none can be, it is asked in one thread.
        self._last, self._orders = (self._clock.now(), newtons), orders

    def _asked(self, text: str) -> float:
        return self._operator.number(f"{text}, compression positive", self._shown, least=-self._most, most=self._most)
