"""TSP that brings a unit of Keithley's 2600 series to its settings, and the function that takes a measurement."""

from typing import Final

#: Name of the function on the instrument: ``cbsr_measure(readings, word)``.
MEASURE: Final = "cbsr_measure"


def settings(
    source: str,
    meter: str,
    *,
    compliance_V: float,
    range_V: float,
    largest_A: float,
    nplc: float,
    current_nplc: float,
) -> list[str]:
    """Return the lines, from a reset on; both channels are off after them.

    Numbers are written with ten digits: an instrument that is sent ``%f`` takes small currents for zero.

    Parameters
    ----------
    source, meter : ``smua`` and ``smub`` or the other way round; the meter is a source of no current.
    compliance_V, range_V, largest_A : voltage limit of both, range of the meter, range of the source.
    nplc, current_nplc : apertures of the meter and of the source's own current, in power line cycles.
    """
    lines = [
        "reset()",
        "errorqueue.clear()",
        "format.data = format.REAL32",
        "format.byteorder = format.LITTLEENDIAN",
        "format.asciiprecision = 10",
    ]
    for smu in (source, meter):
        lines += [
            f"{smu}.sense = {smu}.SENSE_LOCAL",
            f"{smu}.source.offmode = {smu}.OUTPUT_HIGH_Z",
            f"{smu}.source.func = {smu}.OUTPUT_DCAMPS",
            f"{smu}.source.leveli = 0",
            f"{smu}.source.limitv = {compliance_V:.9e}",
            f"{smu}.measure.autozero = {smu}.AUTOZERO_ONCE",
            f"{smu}.nvbuffer1.appendmode = 1",
        ]
    return [
        *lines,
        f"{source}.source.autorangei = {source}.AUTORANGE_OFF",
        f"{source}.source.rangei = {largest_A:.9e}",
        f"{source}.measure.autorangei = {source}.AUTORANGE_OFF",
        f"{source}.measure.rangei = {largest_A:.9e}",
        f"{source}.measure.nplc = {current_nplc:.9e}",
        f"{meter}.measure.autorangev = {meter}.AUTORANGE_OFF",
        f"{meter}.measure.rangev = {range_V:.9e}",
        f"{meter}.measure.nplc = {nplc:.9e}",
        _measure_function(source, meter),
    ]


def _measure_function(source: str, meter: str) -> str:
    """Lua of one measurement: a loop on the instrument, one block of numbers, and the asker's word behind it."""
    return (
        f"function {MEASURE}(n, word) {meter}.nvbuffer1.clear() {source}.nvbuffer1.clear()"
        f" for k = 1, n do {source}.measure.i({source}.nvbuffer1) {meter}.measure.v({meter}.nvbuffer1) end"
        f" printbuffer(1, n, {meter}.nvbuffer1.readings, {meter}.nvbuffer1.statuses,"
        f" {source}.nvbuffer1.readings, {source}.nvbuffer1.statuses) print(word) end"
    )
