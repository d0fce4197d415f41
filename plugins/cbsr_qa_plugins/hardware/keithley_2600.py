"""Keithley 2600 series source-measure unit: one channel drives the sheet, the other measures (TSP over VISA)."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import CheckResult, InstrumentError, InstrumentIdentity, MeterReading, StationContext, driver
from cbsr_qa.plugin.links.visa_link import VisaLink
from cbsr_qa_plugins.hardware._driver import DriverBase, check_result, close_on_error
from cbsr_qa_plugins.hardware._keithley_tsp import CURRENT_NPLC, MEASURE, KeithleyOptions, TspUnit, settings

_DRIVER: Final = "keithley-2600"
#: Status bits of a reading in a buffer.
_OVER_TEMPERATURE, _COMPLIANCE = 0x02, 0x40
#: The instrument returns 9.91e37 for a reading beyond the range, or an empty buffer.
_NO_NUMBER: Final = 9e37
#: A voltage above this share of the compliance is taken for the limit, as in the rig's own script.
_AT_THE_LIMIT: Final = 0.99
#: Allowed deviation of the readback from the request, as shares of itself and of its range.
_CURRENT_SHARE, _CURRENT_RANGE_SHARE = 0.05, 0.01
#: What the instrument needs for a reading beside the aperture [s], from its data sheet's rates at 0.001 NPLC.
_OVERHEAD_S: Final = 1e-4
#: Without a requested current, neither reads more than this share of its range.
_ZERO_SHARE: Final = 1e-3
#: How long the safe state waits for a thread that hangs in a question before it goes around it [s, real time].
_PATIENCE_S: Final = 0.1


@driver(_DRIVER, KeithleyOptions)
def open_source_meter(context: StationContext, options: KeithleyOptions) -> "Keithley2600":
    """Open a source-measure unit (role ``source_meter``), switched off.

    Options of its table
    --------------------
    address : VISA resource.
    source_channel, meter_channel : which channel drives the current, which one measures; the rig drives with b.
    compliance_V : voltage that the source does not exceed.
    range_V : range of the meter; by default the compliance.
    largest_current_mA : a request for more current is refused.
    nplc : aperture in power line cycles.
    readings : number of readings that the instrument averages.
    timeout_s : longest time for an answer, in addition to the time of the readings.
    visa_backend : backend of pyvisa; ``"@ivi"`` for a vendor's library.

    Raises
    ------
    ConfigError
        If an option is unknown or out of range.
    InstrumentError
        If there is no answer, another instrument answers, or it does not accept its settings.
    """
    return Keithley2600(context, options)


class Keithley2600(DriverBase):
    """A two-channel source-measure unit of the 2600 series.

    Every question carries a unique word that the answer must repeat: an answer that comes late is never taken for
    that to the next question. After any failure the instrument is brought back into step, reset and set up anew
    before it is used again; its output is then off until :meth:`source` is called.
    """

    def __init__(self, context: StationContext, options: KeithleyOptions) -> None:
        super().__init__(context, _DRIVER, options.address)
        self._options = options
        self._source, self._meter = options.source, options.meter
        self._line_Hz = 50.0
        self._lock = threading.RLock()
        self._ready = False
        self._given_A: float | None = None
        timeout_s = options.timeout_s + self.reading_period_s
        self._link = VisaLink(self._role, options.address, timeout_s=timeout_s, backend=options.visa_backend)
        self._unit = TspUnit(self._link)
        with close_on_error(self._link):
            self._unit.greet()
            with self._talking():
                pass

    # --- instrument ---

    def identity(self) -> InstrumentIdentity:
        with self._talking():
            maker, model, serial, firmware = self._unit.identity()
        return self._build_identity(f"{maker} {model}", serial, firmware)

    def safe_state(self) -> None:
        """Switch both outputs off, going around a thread that hangs in a question; checked by reading back.

        InstrumentError if the instrument does not confirm it.
        """
        is_acquired = self._lock.acquire(timeout=_PATIENCE_S)
        try:
            if not is_acquired:
                with suppress(InstrumentError):
                    self._switch_off()
                # The one who hangs gives up at its timeout; only then can an answer be read.
                is_acquired = self._lock.acquire(timeout=2 * self._link.timeout_s)
                if not is_acquired:
                    raise self._error("told to switch off; another question hangs, so that it cannot confirm it")
            self._confirm_off()
        finally:
            if is_acquired:
                self._lock.release()

    def close(self) -> None:
        self._link.close()

    def alive(self) -> None:
        """Ask whether its outputs are as they were left. InstrumentError if it does not answer, or has been reset."""
        with self._talking():
            output = self._unit.numbers(f"{self._source}.source.output")[0]
            if (output == 1) != (self._given_A is not None):
                raise self._error("it has been reset: its output is not as it was left", retryable=True)

    def self_test(self) -> tuple[CheckResult, ...]:
        """Check the error queue, and both channels' readings without a requested current.

        Returns lines ``errors``, ``zero voltage`` and ``zero current``; both channels are off after them.
        """
        with self._lock:
            with self._talking():
                errors = self._unit.errors()
                self._unit.write(f"{self._source}.source.leveli = 0")
                self._switch_on()
                volts, amperes = self._unit.numbers(f"{self._meter}.measure.v()", f"{self._source}.measure.i()")
            self._confirm_off()
        return (
            check_result("errors", not errors, said="; ".join(errors) or "none in its queue"),
            _zero("zero voltage", volts, "V", _ZERO_SHARE * self._options.meter_range_V),
            _zero("zero current", amperes, "A", _ZERO_SHARE * self._options.largest_A),
        )

    # --- source meter ---

    @property
    def reading_period_s(self) -> float:
        return self._options.readings * ((self._options.nplc + CURRENT_NPLC) / self._line_Hz + _OVERHEAD_S)

    @property
    def compliance_V(self) -> float:
        return self._options.compliance_V

    def source(self, current_A: float) -> None:
        """Set the current and switch both channels on; level and output are read back.

        InstrumentError if the current is more than the station allows, or the instrument does not take it.
        """
        if not 0 < abs(current_A) <= self._options.largest_A:
            raise self._error(
                f"{1e3 * current_A:g} mA were asked for; the station allows {1e3 * self._options.largest_A:g} mA",
                remedy="change largest_current_mA of its table, or the current of the frame source",
            )
        with self._talking():
            if self._given_A == current_A:
                return
            self._unit.write(f"{self._source}.source.leveli = {current_A:.9e}")
            self._switch_on()
            self._unit.check_errors("switching the source on")
            self._unit.check({f"{self._source}.source.leveli": current_A, f"{self._source}.source.output": 1.0})
            self._given_A = current_A

    def off(self) -> None:
        """Switch both channels off, and read back that they are."""
        with self._lock:
            self._confirm_off()

    def measure(self) -> MeterReading:
        """Take one measurement: the readings are averaged, and all must have come.

        InstrumentError if the source is off, an answer is lost (retryable) or the instrument too warm.
        """
        with self._talking():
            if self._given_A is None:
                raise self._error("asked to measure while the source is off", retryable=True)
            before_s = self._clock.now()
            values = self._unit.table(MEASURE, self._options.readings, 4)
            time_s = (before_s + self._clock.now()) / 2
            return self._reading(values, time_s)

    # --- how ---

    def _reading(self, values: Array, time_s: float) -> MeterReading:
        volts, meter_status, amperes, source_status = values.T
        if (meter_status > _NO_NUMBER).any() or (source_status > _NO_NUMBER).any():
            got = int((meter_status < _NO_NUMBER).sum())
            raise self._error(f"took {got} of {self._options.readings} readings", retryable=True)
        bits_meter, bits_source = (np.bitwise_or.reduce(s.astype(np.int64)) for s in (meter_status, source_status))
        if (bits_meter | bits_source) & _OVER_TEMPERATURE:
            raise self._error("it is too warm", remedy="let it cool down; check its fan and its surroundings")
        beyond = np.abs(volts) > _NO_NUMBER
        volts = np.where(beyond, self._options.meter_range_V, volts)
        at_limit = np.abs(volts) >= _AT_THE_LIMIT * self._options.compliance_V
        compliance = bool(bits_source & _COMPLIANCE)
        return MeterReading(
            volts=float(volts.mean()),
            current_A=self._check_current(amperes, compliance),
            compliance=compliance,
            saturated=bool(beyond.any() or at_limit.any() or bits_meter & _COMPLIANCE),
            time_s=time_s,
        )

    def _check_current(self, amperes: Array, compliance: bool) -> float:
        """Return the current that flowed; it must be the requested one, unless the source is at its limit."""
        asked_A = float(self._given_A or 0.0)
        if (np.abs(amperes) > _NO_NUMBER).any():
            return asked_A
        found_A = float(amperes.mean())
        allowed_A = _CURRENT_SHARE * abs(asked_A) + _CURRENT_RANGE_SHARE * self._options.largest_A
        if not compliance and abs(found_A - asked_A) > allowed_A:
            reason = f"the source gives {1e3 * found_A:.3g} mA where {1e3 * asked_A:.3g} mA were asked for"
            raise self._error(reason, remedy="look whether somebody switched it off", retryable=True)
        return found_A

    @contextmanager
    def _talking(self) -> Iterator[None]:
        """Have the instrument alone, in step and set up; what ends an exchange early leaves it to be set up anew."""
        with self._lock:
            ready, self._ready = self._ready, False
            if not ready:
                self._set_up()
            yield
            self._ready = True

    def _set_up(self) -> None:
        """Get back into step, make sure who it is, and bring it from anywhere to its settings, switched off."""
        self._given_A = None
        self._unit.recover()
        self._switch_off()
        self._unit.recognise()
        for line in settings(self._options):
            self._unit.write(line)
        self._unit.check_errors("its settings")
        self._line_Hz = self._unit.numbers("localnode.linefreq")[0]
        self._unit.check(
            {
                f"{self._source}.source.limitv": self._options.compliance_V,
                f"{self._source}.source.output": 0.0,
                f"{self._meter}.source.limitv": self._options.compliance_V,
                f"{self._meter}.measure.nplc": self._options.nplc,
            }
        )

    def _switch_on(self) -> None:
        for channel in (self._meter, self._source):
            self._unit.write(f"{channel}.source.output = {channel}.OUTPUT_ON")

    def _switch_off(self) -> None:
        """Switch off both channels in any state; a running script is aborted first."""
        self._unit.write("abort")
        for channel in (self._source, self._meter):
            self._unit.write(f"{channel}.source.output = 0")

    def _confirm_off(self) -> None:
        """Switch off and read back, again if the link was out of step."""
        self._given_A = None
        ready, self._ready = self._ready, False
        if ready:
            with suppress(InstrumentError):
                self._ready = self._says_off()
                return
        with suppress(InstrumentError):  # before any query: the link may fail only in receiving
            self._switch_off()
        self._unit.recover()
        self._says_off()

    def _says_off(self) -> bool:
        """Switch off; true where reading back confirms it."""
        self._switch_off()
        outputs = self._unit.numbers(f"{self._source}.source.output", f"{self._meter}.source.output")
        if any(outputs):
            raise self._error(f"told to switch off, it says its outputs are {outputs}")
        return True


def _zero(name: str, value: float, unit: str, largest: float) -> CheckResult:
    number = value if abs(value) < _NO_NUMBER else None
    remedy = "take the leads off and ask again: what is left is the unit's own and wants its calibration"
    return check_result(name, abs(value) <= largest, number, unit, f"within {largest:.3g} {unit}", remedy=remedy)
