"""Thermometer that sends text lines over a serial port, all the time.

Load cell that sends text lines over a serial port, all the time: an HX711 on a microcontroller, a scale.

Lines carry no checksum: one that is no number is skipped, but a digit that was garbled into another is not told from
a reading.
"""

from collections.abc import Iterator
from typing import Annotated, Final, Literal

from pydantic import Field

from cbsr_qa.domain.readings import SampleBlock
from cbsr_qa.domain.run import InstrumentIdentity
from cbsr_qa.plugin import PluginOptions, Problem, StationContext, driver
from cbsr_qa.plugin.links import SerialLink
from cbsr_qa_plugins.hardware._force_cell import CellOptions, ForceCell, Scale
from cbsr_qa_plugins.hardware._line_sampler import LineSampler
from cbsr_qa_plugins.hardware._options import Baud, Factor, Port

_DRIVER: Final = "serial-load-cell"


class LoadCellOptions(CellOptions):
    """Options of the load cell's table."""

    address: Port
    baud: Baud = 115200
    time: Literal["device_ms", "arrival"] = "device_ms"
    rate_hz: Annotated[float, Field(ge=0.1, le=10_000)] = 8.0
    boot_s: Annotated[float, Field(ge=0.1, le=60)] = 5.0
    unit: Literal["N", "g", "counts"] = "N"

    def problems(self) -> Iterator[Problem]:
        """Nobody but the table knows what a count is."""
        if self.unit == "counts" and "scale" not in self.model_fields_set:
            yield Problem(("scale",), "is missing", "it must be how many newtons one count is")


@driver(_DRIVER, LoadCellOptions)
def open_load_cell(context: StationContext, options: LoadCellOptions) -> ForceCell:
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
    scale, timed = Scale.of(options, options.unit), options.time == "device_ms"
    link = SerialLink(context.role, options.address, baud=options.baud)
    lines = LineSampler(link, context.clock, timed=timed, rate_hz=options.rate_hz, convert=scale.force_N)
    model = f"load cell that sends lines of text, {options.unit}"
    who = InstrumentIdentity(context.role, _DRIVER, model, "", "", simulated=False)
    try:
        lines.wait_for_first(options.boot_s)
        cell = ForceCell(context, lines, options, who=lambda: who, address=options.address)
        cell.tare()
    except BaseException:
        lines.close()
        raise
    return cell


_DRIVER_SERIAL_THERMOMETER: Final = "serial-thermometer"


class ThermometerOptions(PluginOptions):
    """Options of the thermometer's table."""

    address: Port
    baud: Baud = 9600
    time: Literal["arrival", "device_ms"] = "arrival"
    rate_hz: Annotated[float, Field(ge=0.001, le=1000)] = 1.0
    scale: Factor = 1.0
    offset: float = 0.0
    boot_s: Annotated[float, Field(ge=0.1, le=3600)] = 5.0


@driver(_DRIVER_SERIAL_THERMOMETER, ThermometerOptions)
def open_thermometer(context: StationContext, options: ThermometerOptions) -> "SerialThermometer":
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
    link = SerialLink(context.role, options.address, baud=options.baud)
    lines = LineSampler(
        link,
        context.clock,
        timed=options.time == "device_ms",
        rate_hz=options.rate_hz,
        convert=lambda number: options.scale * number + options.offset,
    )
    try:
        lines.wait_for_first(options.boot_s)
    except BaseException:
        lines.close()
        raise
    return SerialThermometer(context, lines)


class SerialThermometer:
    """Samples ``temperature`` all the time."""

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

        InstrumentError if the line is down, or carries something else.
        """
        return SampleBlock(self.channel, self.unit, *self._lines.samples_since(time_s))
