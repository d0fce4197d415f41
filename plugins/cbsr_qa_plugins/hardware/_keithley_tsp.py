"""TSP of Keithley's 2600 series: settings, the measuring function, and questions whose answers repeat a word."""

import itertools
from contextlib import suppress
from typing import Final

from cbsr_qa.domain import Array, InstrumentError
from cbsr_qa.plugin.links import VisaLink

#: Set values may be rounded to the instrument's resolution; what is further off was not taken.
_TOLERANCE = 1e-4


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

    def check(self, wanted: dict[str, float]) -> None:
        for (name, value), value_read in zip(wanted.items(), self.numbers(*wanted), strict=True):
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
