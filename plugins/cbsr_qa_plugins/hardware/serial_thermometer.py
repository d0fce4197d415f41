"""Thermometer that sends text lines over a serial port, all the time."""

from typing import Final

from cbsr_qa.domain.frames import SampleBlock
from cbsr_qa.domain.run import InstrumentIdentity
from cbsr_qa.interfaces import StationContext
from cbsr_qa.links.serial_link import SerialLink
from cbsr_qa_plugins.hardware._line_sampler import LineSampler
from cbsr_qa_plugins.hardware._options import InstrumentTable

_DRIVER: Final = "serial-thermometer"
_OPTIONS: Final = ("address", "baud", "time", "rate_hz", "scale", "offset", "boot_s")


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
    table = InstrumentTable(context, _DRIVER, _OPTIONS)
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
        """Return the temperature after a time on the station's clock, up to now.

        Raises
        ------
        InstrumentError
            If the line is down, or carries something else.
        """
        return SampleBlock(self.channel, self.unit, *self._lines.samples_since(time_s))
