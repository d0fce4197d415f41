"""Thermometer that sends text lines over a serial port, all the time.

Load cell that sends text lines over a serial port, all the time: an HX711 on a microcontroller, a scale.

Lines carry no checksum: one that is no number is skipped, but a digit that was garbled into another is not told from
a reading.
"""

from typing import Final

from cbsr_qa.domain.readings import SampleBlock
from cbsr_qa.domain.run import InstrumentIdentity
from cbsr_qa.plugin import StationContext
from cbsr_qa.plugin.links import SerialLink
from cbsr_qa_plugins.hardware._force_cell import CELL_OPTIONS, CellSettings, ForceCell, Scale
from cbsr_qa_plugins.hardware._line_sampler import LineSampler
from cbsr_qa_plugins.hardware._options import InstrumentTable

_DRIVER: Final = "serial-load-cell"
_OPTIONS: Final = ("address", "baud", "time", "rate_hz", "boot_s", "unit", *CELL_OPTIONS)
_UNITS: Final = ("N", "g", "counts")


def open_load_cell(context: StationContext) -> ForceCell:
    """Open a load cell that sends lines of text; it samples ``force`` [N], compression positive.

    Options of its table
    --------------------
    address : serial port, or ``usb:VID:PID:SERIAL``.
    baud : 115200.
    time : ``"device_ms"`` (lines ``<milliseconds>,<value>``; default) or ``"arrival"`` (lines ``<value>``).
    rate_hz : lines a second; 8.
    boot_s : how long the first line is waited for; 5.
    unit : ``"N"`` (default), ``"g"`` or ``"counts"``; of counts the ``scale`` says how many newtons one is.
    scale, offset : quantity in that unit = scale × number + offset; 1 and 0.
    sign : -1 where compression reads negative, as on the rig; 1.
    limit_N : where the cell ends: a reading that stands there says nothing but that the force is above it.
    tare_s : mean of so many seconds at the opening is taken as zero; 0 for none.
    tare_limit_N : more than this at the opening is a load and no zero; 0.5.
    dead_weight_g : a known mass, for the check of the station.

    Raises
    ------
    ConfigError
        If an option is unknown, missing or out of range.
    InstrumentError
        If no such lines come from the address, or something presses on the cell while it is tared.
    """
    table = InstrumentTable(context, _DRIVER, _OPTIONS)
    unit = table.choice("unit", _UNITS, "N")
    scale, settings = Scale.of(table, unit, stated=unit == "counts"), CellSettings.of(table)
    rate_hz = table.number("rate_hz", 8.0, at_least=0.1, at_most=10_000.0)
    timed = table.choice("time", ("device_ms", "arrival"), "device_ms") == "device_ms"
    boot_s = table.number("boot_s", 5.0, at_least=0.1, at_most=60.0)
    address = table.text("address", remedy='name its serial port, e.g. address = "usb:1A86:7523"')
    link = SerialLink(context.role, address, baud=table.whole("baud", 115200, at_least=300, at_most=4_000_000))
    lines = LineSampler(link, context.clock, timed=timed, rate_hz=rate_hz, convert=scale.force_N)
    model = f"load cell that sends lines of text, {unit}"
    who = InstrumentIdentity(context.role, _DRIVER, model, "", "", simulated=False)
    try:
        lines.wait_for_first(boot_s)
        cell = ForceCell(context, lines, settings, who=lambda: who, address=address)
        cell.tare()
    except BaseException:
        lines.close()
        raise
    return cell


_DRIVER_SERIAL_THERMOMETER: Final = "serial-thermometer"
_OPTIONS_SERIAL_THERMOMETER: Final = ("address", "baud", "time", "rate_hz", "scale", "offset", "boot_s")


def open_thermometer(context: StationContext) -> "SerialThermometer":
    """Open a thermometer that sends lines of text; it samples ``temperature`` [°C].

    Options of its table
    --------------------
    address : serial port, or ``usb:VID:PID:SERIAL``.
    baud : 9600.
    time : ``"arrival"`` (lines ``<value>``; default) or ``"device_ms"`` (lines ``<milliseconds>,<value>``).
    rate_hz : lines a second; 1.
    scale, offset : °C = scale × number + offset; 1 and 0.
    boot_s : how long the first line is waited for; 5.

    Raises
    ------
    ConfigError
        If an option is unknown, missing or out of range.
    InstrumentError
        If no such lines come from the address.
    """
    table = InstrumentTable(context, _DRIVER_SERIAL_THERMOMETER, _OPTIONS_SERIAL_THERMOMETER)
    scale, offset = table.number("scale", 1.0), table.number("offset", 0.0)
    if scale == 0:
        raise table.wrong("scale", scale, "it is a number other than 0")
    rate_hz = table.number("rate_hz", 1.0, at_least=0.001, at_most=1000.0)
    timed = table.choice("time", ("arrival", "device_ms"), "arrival") == "device_ms"
    boot_s = table.number("boot_s", 5.0, at_least=0.1, at_most=3600.0)
    link = SerialLink(
        context.role,
        table.text("address", remedy='name its serial port, e.g. address = "usb:1A86:7523"'),
        baud=table.whole("baud", 9600, at_least=300, at_most=4_000_000),
    )
    lines = LineSampler(
        link, context.clock, timed=timed, rate_hz=rate_hz, convert=lambda number: scale * number + offset
    )
    try:
        lines.wait_for_first(boot_s)
    except BaseException:
        lines.close()
        raise
    return SerialThermometer(context, lines)


class SerialThermometer:
    """Samples ``temperature`` all the time.

    Parameters
    ----------
    context : of the station.
    lines : what reads from it.
    """

    channel = "temperature"
    unit = "°C"

    def __init__(self, context: StationContext, lines: LineSampler) -> None:
        self._context, self._lines = context, lines

    def identity(self) -> InstrumentIdentity:
        """Name it by its address: lines of numbers do not say who sends them."""
        self._lines.check_alive()
        model = "thermometer that sends lines of text"
        return InstrumentIdentity(self._context.role, _DRIVER_SERIAL_THERMOMETER, model, "", "", simulated=False)

    def alive(self) -> None:
        """Raise InstrumentError if it has fallen silent."""
        self._lines.check_alive()

    def safe_state(self) -> None:
        """Nothing: it only listens."""

    def close(self) -> None:
        """Give the port back."""
        self._lines.close()

    def samples_since(self, time_s: float) -> SampleBlock:
        """Return the temperature after a time on the station's clock, up to now.

        Raises
        ------
        InstrumentError
            If the line is down, or carries something else.
        """
        return SampleBlock(self.channel, self.unit, *self._lines.samples_since(time_s))
