"""An emulated Keithley 2634B: two channels, nvbuffers, an error queue, and a subset of TSP."""

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from cbsr_qa.simulate.instruments.rig import EmulatedRig
from cbsr_qa.simulate.instruments.streams import Fault
from cbsr_qa.simulate.instruments.tsp import RUNTIME_ERROR, Interpreter, TspError

_IDENTITY: Final = "Keithley Instruments Inc., Model 2634B, 4123456, 3.2.2"
_LINE_HZ: Final = 50.0
#: Printed by the instrument for a missing number.
NO_NUMBER: Final = 9.91e37
_OUT_OF_RANGE: Final = -222
_COMPLIANCE: Final = 0x40
_SEVERITY: Final = 20.0
#: Overrange: a meter's range ends this far above its nominal end.
_OVERRANGE: Final = 1.02
#: Share of the requested current that a source at its limit gives, even if the sheet would allow more.
_STUCK_SHARE: Final = 0.1

_CHANNELS: Final = ("smua", "smub")
_CONSTANTS: Final[Mapping[str, float]] = {
    "format.ASCII": 1,
    "format.REAL32": 2,
    "format.REAL64": 3,
    "format.NORMAL": 0,
    "format.LITTLEENDIAN": 1,
    "localnode.linefreq": _LINE_HZ,
}
_CHANNEL_CONSTANTS: Final[Mapping[str, float]] = {
    "OUTPUT_OFF": 0,
    "OUTPUT_ON": 1,
    "OUTPUT_DCAMPS": 0,
    "OUTPUT_DCVOLTS": 1,
    "OUTPUT_NORMAL": 0,
    "OUTPUT_HIGH_Z": 2,
    "AUTORANGE_OFF": 0,
    "AUTORANGE_ON": 1,
    "AUTOZERO_OFF": 0,
    "AUTOZERO_ONCE": 1,
    "AUTOZERO_AUTO": 2,
    "SENSE_LOCAL": 0,
    "SENSE_REMOTE": 1,
}
#: Unchanged by a reset.
_PROMPTS: Final = "localnode.prompts"
#: Attributes of a channel, their values after a reset, and allowed values.
_CHANNEL: Final[Mapping[str, tuple[float, float, float]]] = {
    "sense": (0, 0, 1),
    "source.func": (1, 0, 1),
    "source.leveli": (0.0, -1.5, 1.5),
    "source.limitv": (20.0, 0.01, 200.0),
    "source.rangei": (1e-7, 0.0, 1.5),
    "source.autorangei": (1, 0, 1),
    "source.output": (0, 0, 1),
    "source.offmode": (0, 0, 2),
    "measure.nplc": (1.0, 0.001, 25.0),
    "measure.rangev": (0.1, 0.0, 200.0),
    "measure.rangei": (1e-7, 0.0, 1.5),
    "measure.autorangev": (1, 0, 1),
    "measure.autorangei": (1, 0, 1),
    "measure.autozero": (2, 0, 2),
    "measure.delay": (0.0, -1.0, 100.0),
    "nvbuffer1.appendmode": (0, 0, 1),
}
_ATTRIBUTES: Final[Mapping[str, tuple[float, float, float]]] = {
    "format.data": (1, 1, 3),
    "format.byteorder": (1, 0, 1),
    "format.asciiprecision": (6, 1, 16),
    _PROMPTS: (0, 0, 1),
    **{f"{channel}.{name}": spec for channel in _CHANNELS for name, spec in _CHANNEL.items()},
}


_CHANNEL_FUNCTIONS: Final = (
    *("reset", "abort", "nvbuffer1.clear"),
    *(f"measure.{quantity}" for quantity in "virp"),
)


@dataclass(slots=True)
class _Buffer:
    readings: list[float] = field(default_factory=list)
    statuses: list[float] = field(default_factory=list)

    def clear(self) -> None:
        self.readings.clear()
        self.statuses.clear()


class EmulatedSourceMeter:
    """Channel B drives the sheet, channel A measures; both over the rig's wiring.

    Faults: COMPLIANCE leaves the source at its limit from now on, RESET makes it forget everything.

    Parameters
    ----------
    options : options of the driver's table: the driving and the measuring channel.
    send : unused; the instrument only answers.
    """

    def __init__(self, rig: EmulatedRig, options: Mapping[str, Any], send: Callable[[bytes], None]) -> None:
        self._rig = rig
        self._drives = f"smu{options.get('source_channel', 'b')}"
        self._measures = f"smu{options.get('meter_channel', 'a')}"
        self._held = b""
        self._stuck = False
        self._reset_all()

    def receive(self, data: bytes) -> bytes:
        *lines, self._held = (self._held + data).split(b"\n")
        self._said = bytearray()
        with self._rig.lock:
            for line in lines:
                self._execute(line.decode("ascii", "replace").strip())
        return bytes(self._said)

    def misbehave(self, fault: Fault) -> None:
        with self._rig.lock:
            if fault is Fault.COMPLIANCE:
                self._stuck = True
            elif fault is Fault.RESET:
                self._reset_all()

    # --- the machine of the language ---

    def value(self, name: str) -> Any:
        """Return the value of an attribute, constant, buffer or column."""
        channel, _, attribute = name.partition(".")
        buffer = self._buffers.get(channel)
        values: dict[str, Any] = {**_CONSTANTS, **self._attributes, "errorqueue.count": len(self._errors)}
        if buffer is not None:
            values |= {f"{channel}.{constant}": float(number) for constant, number in _CHANNEL_CONSTANTS.items()}
            buffer_name = f"{channel}.nvbuffer1"
            values |= {
                buffer_name: buffer,
                f"{buffer_name}.readings": buffer.readings,
                f"{buffer_name}.statuses": buffer.statuses,
            }
            values[f"{channel}.source.compliance"] = attribute == "source.compliance" and self._is_limited(channel)
        if name not in values:
            raise _runtime_error(f"attempt to index `{name}' (a nil value)")
        return values[name]

    def assign(self, name: str, value: Any) -> None:
        if (bounds := _ATTRIBUTES.get(name)) is None:
            raise _runtime_error(f"attempt to set `{name}'")
        if not isinstance(value, float | int) or not bounds[1] <= value <= bounds[2]:
            raise TspError(_OUT_OF_RANGE, "Parameter data out of range")
        self._attributes[name] = float(value)
        ranges_itself = name.replace(".range", ".autorange")
        if ranges_itself != name and ranges_itself in self._attributes:
            self._attributes[ranges_itself] = 0.0  # as in the instrument, a fixed range is kept
        self._wire()

    def call(self, name: str, arguments: Sequence[Any]) -> tuple[Any, ...]:
        channel, _, function = name.partition(".")
        if channel in self._buffers and function in _CHANNEL_FUNCTIONS:
            return self._call_channel(channel, function, arguments)
        if name == "reset":
            self._reset()
        elif name == "print":
            self._said += "\t".join(map(self._format_value, arguments)).encode() + b"\n"
        elif name == "printbuffer":
            self._print_buffers(*arguments)
        elif name == "errorqueue.clear":
            self._errors.clear()
        elif name == "errorqueue.next":
            return self._errors.pop(0) if self._errors else (0.0, "Queue Is Empty", 0.0, 1.0)
        else:
            raise _runtime_error(f"attempt to call `{name}' (a nil value)")
        return ()

    # --- what it does ---

    def _execute(self, line: str) -> None:
        if line == "*IDN?":
            self._said += _IDENTITY.encode() + b"\n"
        elif line == "*RST":
            self._reset()
        elif line == "*CLS":
            self._errors.clear()
        elif line not in ("", "abort"):
            try:
                self._tsp.run(line)
            except TspError as error:
                self._errors.append((float(error.code), str(error), _SEVERITY, 1.0))
        if self._attributes["localnode.prompts"]:
            self._said += b"TSP>\n"

    def _reset_all(self) -> None:
        """Reset, as after a power cycle."""
        self._errors: list[tuple[float, str, float, float]] = []
        self._said = bytearray()
        self._tsp = Interpreter(self)
        self._buffers = {channel: _Buffer() for channel in _CHANNELS}
        self._attributes = {_PROMPTS: 0.0}
        self._reset()

    def _reset(self) -> None:
        kept_attributes = {_PROMPTS: self._attributes[_PROMPTS]}
        self._attributes = {name: spec[0] for name, spec in _ATTRIBUTES.items()} | kept_attributes
        for buffer in self._buffers.values():
            buffer.clear()
        self._wire()

    def _wire(self) -> None:
        """Tell the rig the state of the driving channel."""
        func, output, level_A, limit_V = (
            self._attributes[f"{self._drives}.source.{name}"] for name in ("func", "output", "leveli", "limitv")
        )
        self._rig.wiring.current_A = level_A if output == 1 and func == 0 else None
        self._rig.wiring.limit_V = limit_V

    def _call_channel(self, channel: str, rest: str, arguments: Sequence[Any]) -> tuple[Any, ...]:
        if rest.startswith("measure"):
            return (self._measure(channel, rest[-1], *arguments),)
        if rest == "nvbuffer1.clear":
            self._buffers[channel].clear()
        elif rest == "reset":
            self._attributes |= {f"{channel}.{name}": spec[0] for name, spec in _CHANNEL.items()}
            self._wire()
        return ()

    def _measure(self, channel: str, quantity: str, buffer: _Buffer | None = None) -> float:
        """Take one reading (of v, i, r = v/i or p = v i), with its duration; put it into a buffer."""
        self._rig.clock.sleep(self._attributes[f"{channel}.measure.nplc"] / _LINE_HZ)
        if quantity in "vi":
            value = self._measure_in_range(channel, quantity)
        else:
            volts, amperes = (self._measure_in_range(channel, measured) for measured in "vi")
            overflows = NO_NUMBER in (volts, amperes) or (quantity == "r" and amperes == 0)
            value = NO_NUMBER if overflows else volts * amperes if quantity == "p" else volts / amperes
        if buffer is not None:
            if not self._attributes[f"{channel}.nvbuffer1.appendmode"]:
                buffer.clear()
            buffer.readings.append(value)
            buffer.statuses.append(float(_COMPLIANCE if self._is_limited(channel) else 0))
        return value

    def _measure_in_range(self, channel: str, quantity: str) -> float:
        """Return volts or amperes of a channel; the instrument's number for "overflow" beyond its range."""
        if quantity == "v":
            value = self._volts(channel)
        elif channel == self._drives:
            value = self._rig.electrical().current_A * (_STUCK_SHARE if self._stuck else 1.0)
        else:
            value = 0.0
        limit = self._attributes[f"{channel}.measure.range{quantity}"] * _OVERRANGE
        ranges_itself = self._attributes[f"{channel}.measure.autorange{quantity}"] == 1
        return value if ranges_itself or abs(value) <= limit else NO_NUMBER

    def _volts(self, channel: str) -> float:
        electrical = self._rig.electrical()
        if channel == self._measures:
            limit_V = self._attributes[f"{channel}.source.limitv"]
            volts = electrical.volts * (_STUCK_SHARE if self._stuck else 1.0)
            return max(-limit_V, min(limit_V, volts))
        return (
            math.copysign(self._rig.wiring.limit_V, electrical.current_A)
            if self._is_limited(channel)
            else electrical.volts
        )

    def _is_limited(self, channel: str) -> bool:
        electrical = self._rig.electrical()
        if channel == self._drives:
            return self._rig.wiring.current_A is not None and (electrical.limited or self._stuck)
        return abs(electrical.volts) >= self._attributes[f"{channel}.source.limitv"]

    def _print_buffers(self, first: float, last: float, *columns: list[float]) -> None:
        """Print the columns interleaved; NaN for missing values."""
        values = [
            column[k - 1] if 1 <= k <= len(column) else NO_NUMBER
            for k in range(int(first), int(last) + 1)
            for column in columns
        ]
        if self._attributes["format.data"] == _CONSTANTS["format.REAL32"]:
            order = "<" if self._attributes["format.byteorder"] == 1 else ">"
            self._said += b"#0" + struct.pack(f"{order}{len(values)}f", *values) + b"\n"
        else:
            self._said += ", ".join(map(self._format_value, values)).encode() + b"\n"

    def _format_value(self, value: Any) -> str:
        if isinstance(value, str):
            return value
        if value is None or isinstance(value, bool):
            return "nil" if value is None else str(value).lower()
        return f"{value:.{int(self._attributes['format.asciiprecision']) - 1}e}"


def _runtime_error(what: str) -> TspError:
    return TspError(RUNTIME_ERROR, f"TSP Runtime error at line 1: {what}")
