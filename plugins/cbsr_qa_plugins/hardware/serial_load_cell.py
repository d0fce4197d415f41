"""Load cell that sends text lines over a serial port, all the time: an HX711 on a microcontroller, a scale.

Lines carry no checksum: one that is no number is skipped, but a digit that was garbled into another is not told from
a reading.
"""

from typing import Final

from cbsr_qa.domain.run import InstrumentIdentity
from cbsr_qa.interfaces import StationContext
from cbsr_qa.links.serial_link import SerialLink
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
