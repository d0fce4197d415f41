"""Load cell that sends text lines over a serial port, all the time: an HX711 on a microcontroller, a scale."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import InstrumentError, SafetyError
from cbsr_qa.domain.frames import SampleBlock
from cbsr_qa.domain.run import InstrumentIdentity
from cbsr_qa.interfaces import StationContext
from cbsr_qa.links.serial_link import SerialLink
from cbsr_qa_plugins.hardware._dead_weight import NEWTON_PER_G, DeadWeightCheck, dead_weight_check
from cbsr_qa_plugins.hardware._line_sampler import LineSampler
from cbsr_qa_plugins.hardware._options import InstrumentTable

_DRIVER: Final = "serial-load-cell"
_OPTIONS: Final = (
    "address",
    "baud",
    "time",
    "rate_hz",
    "unit",
    "scale",
    "offset",
    "sign",
    "limit_N",
    "tare_s",
    "tare_limit_N",
    "boot_s",
    "dead_weight_g",
    "dead_weight_tolerance_percent",
)
_UNITS: Final = ("N", "g", "counts")
#: Beyond this share of its limit a cell is at its limit: amplifiers end a digit or two before it.
_AT_LIMIT: Final = 0.999
#: So many samples there after each other are flat.
_FLAT: Final = 2


@dataclass(frozen=True, slots=True)
class Scale:
    """From the number of a line to the force.

    Parameters
    ----------
    per_unit_N : newtons per unit.
    scale, offset : quantity in that unit = scale × number + offset.
    sign : 1 where compression reads positive, -1 where it reads negative.
    """

    per_unit_N: float
    scale: float
    offset: float
    sign: int

    def force_N(self, number: float) -> float:
        """Return the force, compression positive [N]."""
        return self.sign * self.per_unit_N * (self.scale * number + self.offset)


def open_load_cell(context: StationContext) -> "SerialLoadCell":
    """Open a load cell that sends lines of text; it samples ``force`` [N], compression positive.

    Options of its table
    --------------------
    address : serial port, or ``usb:VID:PID:SERIAL``.
    baud : 115200.
    time : ``"device_ms"`` (lines ``<milliseconds>,<value>``; default) or ``"arrival"`` (lines ``<value>``).
    rate_hz : lines a second; 8.
    unit : ``"N"`` (default), ``"g"`` or ``"counts"``; of counts the ``scale`` says how many newtons one is.
    scale, offset : quantity in that unit = scale × number + offset; 1 and 0.
    sign : -1 where compression reads negative, as on the rig; 1.
    limit_N : where the cell ends: a reading that stands there says nothing but that the force is above it.
    tare_s : mean of so many seconds at the opening is taken as zero; 0 for none.
    tare_limit_N : more than this at the opening is a load and no zero; 0.5.
    boot_s : how long the first line is waited for; 5.
    dead_weight_g, dead_weight_tolerance_percent : mass for the check of the station, and what it may be off; 1 %.

    Raises
    ------
    ConfigError
        If an option is unknown, missing or out of range.
    InstrumentError
        If no such lines come from the address, or something presses on the cell while it is tared.
    """
    table = InstrumentTable(context, _DRIVER, _OPTIONS)
    scale = _scale(table)
    rate_hz = table.number("rate_hz", 8.0, at_least=0.1, at_most=10_000.0)
    timed = table.choice("time", ("device_ms", "arrival"), "device_ms") == "device_ms"
    limit_N = table.number("limit_N", at_least=1e-3) if table.has("limit_N") else None
    tare_s = table.number("tare_s", 0.0, at_least=0.0, at_most=60.0)
    tare_limit_N = table.number("tare_limit_N", 0.5, at_least=0.0)
    boot_s = table.number("boot_s", 5.0, at_least=0.1, at_most=60.0)
    mass_g = table.number("dead_weight_g", at_least=0.1) if table.has("dead_weight_g") else None
    percent = table.number("dead_weight_tolerance_percent", 1.0, at_least=1e-3, at_most=100.0)
    link = SerialLink(
        context.role,
        table.text("address", remedy='name its serial port, e.g. address = "usb:1A86:7523"'),
        baud=table.whole("baud", 115200, at_least=300, at_most=4_000_000),
    )
    lines = LineSampler(link, context.clock, timed=timed, rate_hz=rate_hz, convert=scale.force_N)
    cell = SerialLoadCell(context, link, lines, limit_N=limit_N, dead_weight_g=mass_g, tolerance_percent=percent)
    try:
        lines.wait_for_first(boot_s)
        if tare_s > 0:
            cell.tare(tare_s, tare_limit_N)
    except BaseException:
        cell.close()
        raise
    return cell


class SerialLoadCell:
    """Samples ``force`` all the time.

    Parameters
    ----------
    context : of the station.
    link, lines : the open port, and what reads on it.
    limit_N : where the cell ends; None where nobody says.
    dead_weight_g, tolerance_percent : of the check with a known mass; None where there is none.
    """

    channel = "force"
    unit = "N"

    def __init__(
        self,
        context: StationContext,
        link: SerialLink,
        lines: LineSampler,
        *,
        limit_N: float | None,
        dead_weight_g: float | None,
        tolerance_percent: float,
    ) -> None:
        self._context, self._link, self._lines, self._limit_N = context, link, lines, limit_N
        self._dead_weight_g, self._tolerance_percent = dead_weight_g, tolerance_percent
        self._zero_N = 0.0

    @property
    def skipped(self) -> int:
        """Lines so far that could not be read, or were sent twice."""
        return self._lines.skipped

    def identity(self) -> InstrumentIdentity:
        """Name it by its address: lines of numbers do not say who sends them."""
        self._lines.check_alive()
        model = f"load cell that sends lines at {self._link.address}"
        return InstrumentIdentity(self._context.role, _DRIVER, model, "", "", simulated=False)

    def alive(self) -> None:
        """Raise InstrumentError if it has fallen silent."""
        self._lines.check_alive()

    def safe_state(self) -> None:
        """Nothing: it only listens."""

    def close(self) -> None:
        """Give the port back."""
        self._lines.close()

    def samples_since(self, time_s: float) -> SampleBlock:
        """Return the force after a time on the station's clock, up to now.

        Raises
        ------
        InstrumentError
            If the line is down, or carries something else.
        SafetyError
            With rule ``force``, while the cell stands at its limit: the force may be anything above it.
        """
        times, values = self._lines.samples_since(time_s)
        self._check_limit()
        return SampleBlock(self.channel, self.unit, times, values - self._zero_N)

    def tare(self, window_s: float, limit_N: float) -> float:
        """Take the mean of the coming seconds as zero; returns by how much it was shifted [N].

        Raises
        ------
        InstrumentError
            If something presses on the cell.
        """
        mean_N, _ = self._mean_N(window_s)
        shift_N = mean_N - self._zero_N
        if abs(shift_N) > limit_N:
            raise self._error(
                f"it reads {shift_N:.3g} N before it is tared; more than {limit_N:g} N is a load and no zero",
                "take off what presses on it, lift the head, or mend 'offset' in its table",
            )
        self._zero_N = mean_N
        return shift_N

    def dead_weight_check(self, mass_g: float, *, tolerance_percent: float = 1.0) -> DeadWeightCheck:
        """Compare two seconds under a known mass with its weight."""
        mean_N, error_N = self._mean_N(2.0)
        return dead_weight_check(mean_N - self._zero_N, error_N, mass_g, tolerance_percent)

    def _mean_N(self, window_s: float) -> tuple[float, float]:
        """Return the mean over the coming seconds, as read, and its standard error [N]."""
        since_s = self._context.clock.now()
        self._context.clock.sleep(window_s)
        _, values = self._lines.samples_since(since_s)
        if not len(values):
            raise self._error(f"it sent nothing for {window_s:g} s", "check its power and its cable")
        self._check_limit()
        spread_N = float(values.std(ddof=1)) if len(values) > 1 else 0.0
        return float(values.mean()), spread_N / float(np.sqrt(len(values)))

    def _check_limit(self) -> None:
        """Refuse a cell that stands at its limit now, and is flat there."""
        if self._limit_N is None:
            return
        last = np.abs(self._lines.newest(_FLAT))
        if len(last) == _FLAT and (last >= _AT_LIMIT * self._limit_N).all():
            raise SafetyError(
                "force",
                f"{self._context.role} stands at its limit of {self._limit_N:g} N: the force may be anything above",
                remedy="check what presses on it; a cell that stays there unloaded is broken",
            )

    def _error(self, reason: str, remedy: str) -> InstrumentError:
        return InstrumentError(self._context.role, self._link.address, reason, remedy=remedy)


def _scale(table: InstrumentTable) -> Scale:
    unit = table.choice("unit", _UNITS, "N")
    per_count = table.number("scale") if unit == "counts" else table.number("scale", 1.0)
    if per_count == 0:
        raise table.wrong("scale", per_count, "it is a number other than 0")
    sign = table.whole("sign", 1, at_least=-1, at_most=1)
    if sign == 0:
        raise table.wrong("sign", sign, "it is 1, or -1 where compression reads negative")
    return Scale(NEWTON_PER_G if unit == "g" else 1.0, per_count, table.number("offset", 0.0), sign)
