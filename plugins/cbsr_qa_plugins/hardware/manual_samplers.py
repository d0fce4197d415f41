"""A load cell or scale, and a thermometer, read by an operator: asked again until the answer is a number."""

import math
import re
from collections.abc import Callable, Mapping
from typing import Annotated, Final, Literal, Protocol, runtime_checkable

import numpy as np
from pydantic import Field

from cbsr_qa.plugin import (
    ConfigError,
    Instrument,
    InstrumentError,
    InstrumentIdentity,
    PluginOptions,
    SampleBlock,
    StationContext,
    driver,
)
from cbsr_qa_plugins.hardware._driver import DriverBase, Text, config_error

#: Number of invalid answers before giving up.
_MAX_QUESTIONS: Final = 5
_NUMBER: Final = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)


@runtime_checkable
class HandMoved(Instrument, Protocol):
    """A head that is moved by hand, as a load cell that is read by hand needs to know it."""

    @property
    def orders(self) -> int:
        """Number of orders to move."""

    @property
    def down(self) -> bool:
        """Whether it is in the sheet according to the orders."""


class Operator:
    """Asks the operator until the answer is valid. ConfigError without an operator."""

    def __init__(self, context: StationContext, driver: str) -> None:
        if context.ask is None:
            problem = " is operated by hand, and there is no operator to ask"
            remedy = "start the run at a terminal, or use a driver that needs no operator"
            raise config_error(context, driver, problem, remedy)
        self._role = context.role
        self._ask: Callable[[str], str] = context.ask

    def request_action(self, text: str) -> None:
        """Request an action; any answer confirms it."""
        self._ask(f"{self._role}: {text}. Press Enter when done.")

    def number(self, text: str, unit: str, *, least: float, most: float, default: float | None = None) -> float:
        """Ask for a number until there is one within bounds.

        InstrumentError if no answer was one.

        Parameters
        ----------
        unit : the answer's; it may be typed behind the number.
        default : meaning of an empty answer; None if it is invalid.
        """
        question = f"{self._role}: {text} [{unit}]:"
        for _ in range(_MAX_QUESTIONS):
            answer = self._ask(question).strip()
            if not answer and default is not None:
                return default
            value = _parse_number(answer, unit)
            if value is not None and least <= value <= most:
                return value
            wrong = f"{answer!r} is not a number" if value is None else f"{value:g} {unit} is not within its bounds"
            question = f"{self._role}: {wrong}. {text}, from {least:g} to {most:g} [{unit}]:"
        raise InstrumentError(
            self._role,
            "the operator",
            f"{_MAX_QUESTIONS} answers were not a number of {unit} within {least:g} to {most:g}",
        )


def _parse_number(answer: str, unit: str) -> float | None:
    """Return the number of an answer such as ``1.5`` or ``1.5 mm``; None if it is not one, or not a finite one."""
    text = answer.removesuffix(unit).strip()
    if not _NUMBER.fullmatch(text):
        return None
    value = float(text)
    return value if math.isfinite(value) else None


class ReadingOptions(PluginOptions):
    """Options of whatever is read by hand."""

    label: Text
    number: Text | None = None


class HandRead(DriverBase):
    """Asks for a reading when one is due, and samples nothing in between.

    Parameters
    ----------
    what : name of the instrument that is read, for messages.
    """

    channel: str
    unit: str

    def __init__(self, context: StationContext, driver: str, options: ReadingOptions, what: str) -> None:
        super().__init__(context, driver, "the operator")
        self._operator = Operator(context, driver)
        self._label, self._number, self._what = options.label, options.number or "", what
        self._head: HandMoved | None = None
        self._last: tuple[float, float] | None = None

    def identity(self) -> InstrumentIdentity:
        """Return the identity in the table: it has no query."""
        return self._build_identity(self._label, self._number)

    def link(self, peers: Mapping[str, Instrument]) -> None:
        """Link to the head; ConfigError if it is motorised: it would press on while the operator reads."""
        head = peers.get("force_applicator")
        if not isinstance(head, HandMoved):
            raise ConfigError(
                f"{self._what} that is read by an operator is for a head that is moved by hand",
                remedy="a head that moves by itself needs instruments that sample by themselves",
            )
        self._head = head

    def samples_since(self, time_s: float) -> SampleBlock:
        """Return the last reading if it is younger than a time, after asking for one that is due."""
        if self._due():
            value = self._read()
            self._last = (self._clock.now(), value)
        new = [self._last] if self._last is not None and self._last[0] > time_s else []
        times, values = np.array(new, dtype=np.float64).reshape(-1, 2).T
        return SampleBlock(self.channel, self.unit, times, values)

    def _due(self) -> bool:
        raise NotImplementedError

    def _read(self) -> float:
        raise NotImplementedError


_CELL: Final = "manual-load-cell"
_THERMOMETER: Final = "manual-thermometer"
_GRAVITY: Final = 9.80665  # standard gravity [m/s²]
_NEWTONS: Final[Mapping[str, float]] = {"N": 1.0, "g": 1e-3 * _GRAVITY, "kg": _GRAVITY}
#: How long a reading counts where the station says nothing [s].
_COUNTS_S: Final = 2.0


class ManualCellOptions(ReadingOptions):
    label: Text = "load cell read by hand"
    unit: Literal["N", "g", "kg"]
    capacity: Annotated[float, Field(ge=1e-6)]
    tare: bool = True


@driver(_CELL, ManualCellOptions)
def open_load_cell(context: StationContext, options: ManualCellOptions) -> "ManualLoadCell":
    """Open a load cell that is read by an operator.

    Options of its table
    --------------------
    label, number : name and serial number of the cell, for the record.
    unit : unit of its display, compression positive.
    capacity : largest possible reading, in that unit.
    tare : whether the reading with the head up is requested once and subtracted.

    Raises
    ------
    ConfigError
        If an option is missing or wrong, or there is no operator to be asked.
    """
    return ManualLoadCell(context, options)


class ManualLoadCell(HandRead):
    """Asks for a reading whenever one is due, and samples nothing in between.

    One is due once the head was told to go anywhere, and, while the head is down, as soon as half the time has passed
    for which the station lets a force count (``stale_s``). The station's rule on stale force holds as for any load
    cell: a station that is worked by hand allows a minute or two, and in a longer hold the force is read again.
    """

    channel = "force"
    unit = "N"

    def __init__(self, context: StationContext, options: ManualCellOptions) -> None:
        super().__init__(context, _CELL, options, "a load cell")
        self._display_unit, self._capacity = options.unit, options.capacity
        self._tare: float | None = None if options.tare else 0.0
        self._repeat_after_s = (context.safety.stale_s if context.safety is not None else _COUNTS_S) / 2
        self._orders = -1

    def _due(self) -> bool:
        if self._head is None or self._last is None or self._head.orders != self._orders:
            return True
        return self._head.down and self._clock.now() - self._last[0] > self._repeat_after_s

    def _read(self) -> float:
        """Ask for the tare if unknown, then for a reading."""
        down = self._head is not None and self._head.down
        orders = -1 if self._head is None else self._head.orders
        if self._tare is None and not down:
            self._tare = self._ask_force("with the head up and nothing on it, read the load cell (its tare)")
            reading = self._tare
        else:
            reading = self._ask_force(f"read the load cell, the head is {'down' if down else 'up'}")
        # No order can change the depth during this reading, which is taken in one thread.
        self._orders = orders
        return (reading - (self._tare or 0.0)) * _NEWTONS[self._display_unit]

    def _ask_force(self, text: str) -> float:
        return self._operator.number(
            f"{text}, compression positive", self._display_unit, least=-self._capacity, most=self._capacity
        )


#: A limited temperature may be five minutes old; a question takes its time.
_LIMITED_MIN, _UNLIMITED_MIN = 3.0, 30.0
_COLDEST_C, _HOTTEST_C = -40.0, 100.0


class ManualThermometerOptions(ReadingOptions):
    label: Text = "thermometer read by hand"
    every_min: Annotated[float, Field(ge=0.1)] | None = None


@driver(_THERMOMETER, ManualThermometerOptions)
def open_thermometer(context: StationContext, options: ManualThermometerOptions) -> "ManualThermometer":
    """Open a thermometer that is read by an operator; it samples ``temperature`` [°C].

    Options of its table
    --------------------
    label, number : name and serial number of the thermometer, for the record.
    every_min : time between readings; by default 3 minutes if the station limits the temperature, else 30.

    Raises
    ------
    ConfigError
        If an option is wrong, or there is no operator to be asked.
    """
    return ManualThermometer(context, options)


class ManualThermometer(HandRead):
    """Asks for a reading whenever the last one has become too old."""

    channel = "temperature"
    unit = "°C"

    def __init__(self, context: StationContext, options: ManualThermometerOptions) -> None:
        super().__init__(context, _THERMOMETER, options, "a thermometer")
        limited = context.safety is not None and context.safety.temperature_C is not None
        self._every_s = 60.0 * (options.every_min or (_LIMITED_MIN if limited else _UNLIMITED_MIN))

    def _due(self) -> bool:
        return self._last is None or self._clock.now() - self._last[0] >= self._every_s

    def _read(self) -> float:
        return self._operator.number("read the thermometer", self.unit, least=_COLDEST_C, most=_HOTTEST_C)
