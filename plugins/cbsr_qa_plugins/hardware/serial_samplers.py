"""Instruments that send text lines over a serial port all the time: a load cell or scale, and a thermometer.

Lines carry no checksum: one that is no number is skipped, but a digit that was garbled into another is not told from
a reading.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Annotated, Final, Literal

from pydantic import Field

from cbsr_qa.plugin import InstrumentIdentity, PluginOptions, Problem, SampleBlock, SerialLink, StationContext, driver
from cbsr_qa_plugins.hardware._driver import Baud, DriverBase, Factor, Port, close_on_error
from cbsr_qa_plugins.hardware._force_cell import CellOptions, ForceCell
from cbsr_qa_plugins.hardware._line_sampler import LineSampler

_CELL: Final = "serial-load-cell"
_THERMOMETER: Final = "serial-thermometer"


class LoadCellOptions(CellOptions):
    address: Port
    baud: Baud = 115200
    time: Literal["device_ms", "arrival"] = "device_ms"
    rate_hz: Annotated[float, Field(ge=0.1, le=10_000)] = 8.0
    boot_s: Annotated[float, Field(ge=0.1, le=60)] = 5.0
    unit: Literal["N", "g", "counts"] = "N"

    def problems(self) -> Iterator[Problem]:
        """The scale of a count must be stated."""
        if self.unit == "counts" and "scale" not in self.model_fields_set:
            yield Problem(("scale",), "is missing", "it must be how many newtons one count is")


@driver(_CELL, LoadCellOptions)
def open_load_cell(context: StationContext, options: LoadCellOptions) -> ForceCell:
    """Open a load cell that sends lines of text; it samples ``force`` [N], compression positive.

    Options of its table
    --------------------
    address : serial port, or ``usb:VID:PID:SERIAL``.
    baud : baud rate.
    time : ``"device_ms"`` (lines ``<milliseconds>,<value>``) or ``"arrival"`` (lines ``<value>``).
    rate_hz : lines per second.
    boot_s : how long to wait for the first line.
    unit : ``"N"``, ``"g"`` or ``"counts"``; for counts, ``scale`` is newtons per count.
    scale, offset : quantity in that unit = scale × number + offset.
    sign : -1 if compression reads negative, as on the rig.
    limit_N : end of the cell's range: readings at this value break the run.
    tare_s : the mean over this time at opening becomes the zero; 0: no tare.
    tare_limit_N : a larger force at opening is a load, not a zero.
    dead_weight_g : a known mass for the check of the station.

    Raises
    ------
    ConfigError
        If an option is unknown, missing or out of range.
    InstrumentError
        If no such lines come from the address, or something presses on the cell while it is tared.
    """
    lines = _lines(context, options, partial(options.force_N, unit=options.unit))
    model = f"load cell that sends lines of text, {options.unit}"
    with close_on_error(lines):
        cell = ForceCell(context, lines, options, driver=_CELL, address=options.address, who=lambda: (model,))
        cell.tare()
        return cell


class ThermometerOptions(PluginOptions):
    address: Port
    baud: Baud = 9600
    time: Literal["arrival", "device_ms"] = "arrival"
    rate_hz: Annotated[float, Field(ge=0.001, le=1000)] = 1.0
    scale: Factor = 1.0
    offset: float = 0.0
    boot_s: Annotated[float, Field(ge=0.1, le=3600)] = 5.0


@driver(_THERMOMETER, ThermometerOptions)
def open_thermometer(context: StationContext, options: ThermometerOptions) -> "SerialThermometer":
    """Open a thermometer that sends lines of text; it samples ``temperature`` [°C].

    Options of its table
    --------------------
    address : serial port, or ``usb:VID:PID:SERIAL``.
    baud : baud rate.
    time : ``"arrival"`` (lines ``<value>``) or ``"device_ms"`` (lines ``<milliseconds>,<value>``).
    rate_hz : lines per second.
    scale, offset : °C = scale × number + offset.
    boot_s : how long to wait for the first line.

    Raises
    ------
    ConfigError
        If an option is unknown, missing or out of range.
    InstrumentError
        If no such lines come from the address.
    """
    lines = _lines(context, options, lambda number: options.scale * number + options.offset)
    return SerialThermometer(context, options, lines)


def _lines(
    context: StationContext, options: LoadCellOptions | ThermometerOptions, convert: Callable[[float], float]
) -> LineSampler:
    """Open the port, and wait for the first line."""
    link = SerialLink(context.role, options.address, baud=options.baud)
    timed = options.time == "device_ms"
    lines = LineSampler(link, context.clock, timed=timed, rate_hz=options.rate_hz, convert=convert)
    with close_on_error(lines):
        lines.wait_for_first(options.boot_s)
    return lines


class SerialThermometer(DriverBase):
    """Samples ``temperature`` all the time."""

    channel = "temperature"
    unit = "°C"

    def __init__(self, context: StationContext, options: ThermometerOptions, lines: LineSampler) -> None:
        super().__init__(context, _THERMOMETER, options.address)
        self._lines = lines

    def identity(self) -> InstrumentIdentity:
        """Name it by its address: lines of numbers do not say who sends them."""
        self._lines.check_alive()
        return self._build_identity("thermometer that sends lines of text")

    def alive(self) -> None:
        """Raise InstrumentError if it has fallen silent."""
        self._lines.check_alive()

    def close(self) -> None:
        self._lines.close()

    def samples_since(self, time_s: float) -> SampleBlock:
        """Return the temperature after a time on the station's clock, up to now.

        InstrumentError if the line is down, or carries something else.
        """
        return SampleBlock(self.channel, self.unit, *self._lines.samples_since(time_s))
