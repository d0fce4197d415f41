"""TSP of Keithley's 2600 series: settings, the measuring function, and questions whose answers repeat a word."""

import itertools
from collections.abc import Iterator
from contextlib import suppress
from typing import Annotated, Final, Literal

from pydantic import Field

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import InstrumentError, PluginOptions, Problem
from cbsr_qa.plugin.links.visa_link import VisaLink
from cbsr_qa_plugins.hardware._driver import Text

#: Set values may be rounded to the instrument's resolution; what is further off was not taken.
_TOLERANCE = 1e-4

#: The source's own current is read this fast: it costs 20 µs and brings the status bit of its limit [NPLC].
CURRENT_NPLC: Final = 0.001
Volts = Annotated[float, Field(ge=0.02, le=200)]


class KeithleyOptions(PluginOptions):
    """Channels, limits and ranges; apertures are in power line cycles (``nplc``)."""

    address: Annotated[Text, Field(description='a VISA resource, e.g. "TCPIP::192.168.0.5::5025::SOCKET"')]
    source_channel: Literal["a", "b"] = "b"
    meter_channel: Literal["a", "b"] = "a"
    compliance_V: Volts = 20.0
    range_V: Volts | None = None
    largest_current_mA: Annotated[float, Field(ge=1e-4, le=1000)] = 1.0
    nplc: Annotated[float, Field(ge=0.001, le=25)] = 0.1
    readings: Annotated[int, Field(ge=1, le=1000)] = 1
    timeout_s: Annotated[float, Field(ge=0.01, le=60)] = 1.0
    visa_backend: Text = "@py"

    @property
    def source(self) -> str:
        return f"smu{self.source_channel}"

    @property
    def meter(self) -> str:
        return f"smu{self.meter_channel}"

    @property
    def meter_range_V(self) -> float:
        """Range of the meter; by default the compliance."""
        return self.compliance_V if self.range_V is None else self.range_V

    @property
    def largest_A(self) -> float:
        return 1e-3 * self.largest_current_mA

    def problems(self) -> Iterator[Problem]:
        """One channel drives, the other measures."""
        if self.source_channel == self.meter_channel:
            what = f"is {self.meter_channel!r}, which both drives and measures"
            yield Problem(("meter_channel",), what, "give source_channel and meter_channel different letters")


class TspUnit:
    """A unit controlled by TSP."""

    def __init__(self, link: VisaLink) -> None:
        self._link = link
        self._words = itertools.count(1)
        self._known: tuple[str, str] | None = None

    def write(self, line: str) -> None:
        """Send a line without an answer."""
        self._link.write(line)

    def greet(self) -> None:
        """Ask a stranger who it is, in words every instrument knows: the next ones only the right one knows."""
        try:
            self.identity()
        except InstrumentError as stranger:
            # An answer to an earlier question is not an error: resynchronise.
            try:
                self.recover()
            except InstrumentError:
                raise stranger from None

    def recover(self) -> None:
        """Get back into step; prompts that another program switched on are switched off before they count as answers.

        InstrumentError if there is no answer.
        """
        with suppress(InstrumentError):  # a link that is down is opened again first
            self._link.write("localnode.prompts = 0")
        self._link.recover()

    def identity(self) -> tuple[str, str, str, str]:
        """Return maker, model, serial number and firmware. InstrumentError if it is not of the series."""
        answer = self._link.query("*IDN?")
        parts = [part.strip() for part in answer.split(",")]
        if len(parts) != 4 or "keithley" not in parts[0].lower() or not parts[1].lower().startswith("model 26"):
            raise self._link.error(
                f"it says it is {answer[:80]!r}; a Keithley 2600 series unit is expected",
                remedy="correct the address in the station file",
            )
        return parts[0], parts[1], parts[2], parts[3]

    def recognise(self) -> None:
        """Check that it is still the unit that was identified and recorded.

        InstrumentError if it is another unit, or not of the series.
        """
        _, model, serial, _ = self.identity()
        known = self._known or (model, serial)
        if (model, serial) != known:  # a garbled answer names another unit too: ask again
            _, model, serial, _ = self.identity()
        if (model, serial) != known:
            raise self._link.error(
                f"it was {' '.join(known)} when the station was opened; now {model} {serial} answers",
                remedy="connect the same unit again, or start a new run",
            )
        self._known = known

    def numbers(self, *names: str) -> tuple[float, ...]:
        word = f"w{next(self._words)}"
        answer = self._link.query(f'print("{word}", {", ".join(names)})', mark=word)
        try:
            values = tuple(float(number) for number in answer.split("\t"))
        except ValueError:
            values = ()
        if len(values) != len(names):
            raise self._link.error(f"answered {answer[:80]!r} when asked for {', '.join(names)}", retryable=True)
        return values

    def table(self, function: str, rows: int, columns: int) -> Array:
        """Call a function ``f(rows, word)`` that prints so many binary numbers and then the word: (rows, columns)."""
        word = f"{next(self._words) % 1000000:06d}"
        numbers = self._link.query_binary(f'{function}({rows}, "{word}")', rows * columns, mark=word)
        return numbers.reshape(rows, columns)

    def check(self, expected: dict[str, float]) -> None:
        for (name, value), value_read in zip(expected.items(), self.numbers(*expected), strict=True):
            if abs(value_read - value) > _TOLERANCE * abs(value):
                raise self._link.error(f"{name} was set to {value:.9g}, and reads back as {value_read:.9g}")

    def check_errors(self, doing: str) -> None:
        """Empty the error queue; anything in it is refused."""
        if messages := self.errors():
            raise self._link.error(f"refused {doing}: {'; '.join(messages)}")

    def errors(self) -> list[str]:
        """Empty the error queue: code and message of each."""
        messages = []
        for _ in range(int(self.numbers("errorqueue.count")[0])):
            word = f"w{next(self._words)}"
            code, message, *_ = [*self._link.query(f'print("{word}", errorqueue.next())', mark=word).split("\t"), ""]
            messages.append(f"{float(code):.0f} {message}")
        return messages


#: Name of the function on the instrument: ``cbsr_measure(readings, word)``.
MEASURE: Final = "cbsr_measure"


def settings(options: KeithleyOptions) -> list[str]:
    """Return the lines, from a reset on; both channels are off after them.

    Numbers are written with ten digits: an instrument that is sent ``%f`` takes small currents for zero. The meter is
    a source of no current, with the same voltage limit as the source.
    """
    source, meter = options.source, options.meter
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
            f"{smu}.source.limitv = {options.compliance_V:.9e}",
            f"{smu}.measure.autozero = {smu}.AUTOZERO_ONCE",
            f"{smu}.nvbuffer1.appendmode = 1",
        ]
    return [
        *lines,
        f"{source}.source.autorangei = {source}.AUTORANGE_OFF",
        f"{source}.source.rangei = {options.largest_A:.9e}",
        f"{source}.measure.autorangei = {source}.AUTORANGE_OFF",
        f"{source}.measure.rangei = {options.largest_A:.9e}",
        f"{source}.measure.nplc = {CURRENT_NPLC:.9e}",
        f"{meter}.measure.autorangev = {meter}.AUTORANGE_OFF",
        f"{meter}.measure.rangev = {options.meter_range_V:.9e}",
        f"{meter}.measure.nplc = {options.nplc:.9e}",
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
