"""Frames taken reading by reading: a source-measure unit, and a multiplexer that connects it to the pins."""

import logging
from collections.abc import Iterator, Mapping
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import (
    CheckOutcome,
    CheckResult,
    ConfigError,
    FrameBlock,
    Instrument,
    InstrumentIdentity,
    MeterReading,
    Multiplexer,
    PluginOptions,
    Problem,
    ReadingFlag,
    SourceMeter,
    StationContext,
    VoltageUnit,
    driver,
    join_frames,
)
from cbsr_qa_plugins.hardware._contact_check import ContactFault, ContactState, contact_faults
from cbsr_qa_plugins.hardware._driver import DriverBase, check_result

_DRIVER: Final = "scanned-frames"
Milliampere = Annotated[float, Field(ge=1e-4, le=1000)]
#: The contacts are looked at with this share of the largest current: 200 kΩ and more count as open at 20 V and 1 mA.
_TEST_SHARE: Final = 0.1
#: Currents that are chosen are one of these times a power of ten: the same sensor is read with the same current
#: tomorrow.
_STEPS: Final = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)

_log: Final = logging.getLogger(__name__)


class ScanOptions(PluginOptions):
    current: Literal["auto"] | None = None
    current_mA: Milliampere | None = None
    largest_current_mA: Milliampere = 1.0
    headroom_percent: Annotated[float, Field(ge=0, le=90)] = 25.0
    contacts: Literal["refuse", "warn"] = "refuse"
    polarity: Literal["normal", "reversed"] = "normal"

    def problems(self) -> Iterator[Problem]:
        """A current is stated or chosen."""
        if self.current is not None and self.current_mA is not None:
            yield Problem(("current",), "is given, and current_mA too", "leave one of them out")


@driver(_DRIVER, ScanOptions)
def open_frames(context: StationContext, options: ScanOptions) -> "ScannedFrames":
    """Open a frame source that scans with the bench's ``source_meter`` and ``multiplexer``.

    Options of its table
    --------------------
    current : ``"auto"``, the default: the largest current that leaves the headroom on this sensor.
    current_mA : drive current, instead of ``current``.
    largest_current_mA : upper limit of the drive current.
    headroom_percent : share of the source's voltage limit that stays free.
    contacts : ``"refuse"`` sensors with open pins or pins that touch, or ``"warn"``.
    polarity : ``"reversed"`` if the meter's leads are swapped.

    Raises
    ------
    ConfigError
        If an option is unknown or out of range.
    """
    return ScannedFrames(context, options)


class ScannedFrames(DriverBase):
    """Whole frames in canonical order, whatever order the multiplexer steps in.

    Where it is linked it looks at the contacts and settles the current. A frame is only given away if the
    multiplexer says at its end that it is where a whole round ends; else it is an error that may be tried again, and
    the next attempt begins with the first reading.
    """

    def __init__(self, context: StationContext, options: ScanOptions) -> None:
        super().__init__(context, _DRIVER, "the bench")
        self._pattern = context.sensor_type.pattern
        self._options = options
        self._largest_A = 1e-3 * options.largest_current_mA
        self._sign = -1.0 if options.polarity == "reversed" else 1.0
        self._meter: SourceMeter
        self._multiplexer: Multiplexer
        self._period_s = 0.0
        self._current_A = 0.0
        self._contacts = ""

    # --- instrument ---

    def identity(self) -> InstrumentIdentity:
        """Name what it scans with; the meter and the multiplexer say themselves who they are."""
        notes = (("current", f"{1e3 * self._current_A:g} mA"), ("contacts", self._contacts))
        return self._build_identity("source-measure unit and multiplexer", notes=notes)

    def self_test(self) -> tuple[CheckResult, ...]:
        """Look at the contacts by the driven pairs (line ``contacts``), and at the current (``current``)."""
        ohm = self._measure_pairs_ohm()
        faults = self._contact_faults(ohm)
        poor = all(fault.state is ContactState.POOR for fault in faults)
        contacts = check_result(
            "contacts",
            not faults,
            said=self._contacts,
            remedy="look at the pins and leads that are named",
            otherwise=CheckOutcome.WARNING if poor else CheckOutcome.FAILED,
        )
        volts = self._current_A * float(np.nanmax(np.where(np.isfinite(ohm), np.abs(ohm), 0.0)))
        voltage_text = f"{volts:.3g} V of the source's {self._meter.compliance_V:g} V on the worst pair"
        return contacts, CheckResult("current", CheckOutcome.OK, 1e3 * self._current_A, "mA", said=voltage_text)

    def link(self, peers: Mapping[str, Instrument]) -> None:
        """Take meter and multiplexer, look at the contacts, and settle the current.

        ConfigError if the bench has none; InstrumentError if pins are open or touch (in words), the stated current
        leaves too little headroom, or the meter's leads are the other way round.
        """
        meter, multiplexer = peers.get("source_meter"), peers.get("multiplexer")
        if not isinstance(meter, SourceMeter) or not isinstance(multiplexer, Multiplexer):
            lacks = "multiplexer" if isinstance(meter, SourceMeter) else "source_meter"
            raise ConfigError(
                f"no instrument of the station provides {lacks!r}, which frames are scanned with",
                remedy=f'name one whose table has provides = ["{lacks}"]',
            )
        self._meter, self._multiplexer = meter, multiplexer
        ohm = self._measure_pairs_ohm()
        self._check_contacts(ohm)
        self._current_A = self._choose_current_A(ohm)

    # --- frame source ---

    @property
    def frame_period_s(self) -> float:
        """Time of one frame [s]: of the last one; before the first, as steps and readings took at the link."""
        return self._period_s

    def acquire(self, count: int) -> FrameBlock:
        """Take frames one after the other, each from its first reading on.

        InstrumentError if an answer is lost, or the multiplexer has lost a step (retryable: nothing of the frame is
        kept).
        """
        self._check_count(count)
        return join_frames([self._frame() for _ in range(count)])

    # --- how ---

    def _frame(self) -> FrameBlock:
        shape = self._pattern.shape
        volts, times, flags = np.empty(shape), np.empty(shape), np.empty(shape, dtype=np.uint8)
        start_s = self._clock.now()
        meter, multiplexer = self._meter, self._multiplexer
        multiplexer.start()
        meter.source(self._current_A)
        for drive, measure in multiplexer.order():
            reading = meter.measure()
            volts[drive, measure] = self._sign * reading.volts
            times[drive, measure] = reading.time_s
            flags[drive, measure] = _flag(reading)
            multiplexer.step()
        self._check_round()
        self._period_s = self._clock.now() - start_s
        middle_s = (times.min() + times.max()) / 2
        return FrameBlock(
            np.array([middle_s]), volts[None], flags[None], VoltageUnit.VOLT, self._current_A, times[None]
        )

    def _check_round(self) -> None:
        """Check that a whole round ended at the multiplexer's first combination."""
        position = self._multiplexer.position()
        if position != 0:
            count = len(self._multiplexer.order())
            raise self._error(
                f"after {count} steps the multiplexer is {min(position, count - position)} combinations from where it"
                " began: steps were lost or done twice, and the frame is thrown away",
                retryable=True,
            )

    def _measure_pairs_ohm(self) -> Array:
        """Resistance of each driven pair (drives,): infinite with the source at its limit, NaN where not measured."""
        pattern, multiplexer, meter = self._pattern, self._multiplexer, self._meter
        columns = {frozenset(pair): index for index, pair in enumerate(pattern.measure)}
        ohm = np.full(len(pattern.drive), np.nan)
        multiplexer.start()
        start_s, reading_s = self._clock.now(), 0.0
        meter.source(_TEST_SHARE * self._largest_A)
        for drive, measure in multiplexer.order():
            pair = pattern.drive[drive]
            if columns.get(frozenset(pair)) == measure:
                before_s = self._clock.now()
                turned = -1.0 if pattern.measure[measure] != pair else 1.0
                reading = meter.measure()
                reading_s += self._clock.now() - before_s
                ohm[drive] = np.inf
                if not reading.compliance and reading.current_A != 0:
                    ohm[drive] = self._sign * turned * reading.volts / reading.current_A
            multiplexer.step()
        meter.off()
        self._check_round()
        stepping_s = self._clock.now() - start_s - reading_s
        measured_pairs = int((~np.isnan(ohm)).sum())
        each_s = reading_s / measured_pairs if measured_pairs else meter.reading_period_s
        self._period_s = stepping_s + each_s * len(multiplexer.order())
        return ohm

    def _check_contacts(self, ohm: Array) -> None:
        measured = ohm[~np.isnan(ohm)]
        if not measured.size:
            self._contacts = "not checked: no driven pair is measured itself"
            return
        if not np.isfinite(measured).any():
            limit_V = self._meter.compliance_V
            raise self._error(
                f"no driven pair takes the current within {limit_V:g} V",
                "is a sensor connected, and its cable whole?",
            )
        if np.median(measured) < 0:
            raise self._error(
                f"driven pairs read {np.median(measured) / 1e3:.3g} kΩ: the meter's leads are the other way round",
                'exchange them, or set polarity to the other of "normal" and "reversed"',
            )
        faults = self._contact_faults(ohm)
        findings = [fault.words() for fault in faults]
        if self._options.contacts == "refuse" and any(fault.state is not ContactState.POOR for fault in faults):
            raise self._error(
                "; ".join(findings), 'repair the contact, or set contacts = "warn" to measure all the same'
            )
        for text in findings:
            _log.warning("%s: %s", self._role, text)

    def _contact_faults(self, ohm: Array) -> tuple[ContactFault, ...]:
        """Find the faults, and keep their description."""
        measured = ohm[~np.isnan(ohm)]
        if not measured.size:
            return ()
        faults = contact_faults(self._pattern, np.where(np.isnan(ohm), np.median(measured), np.abs(ohm)))
        known = np.abs(measured[np.isfinite(measured)])
        pairs = (
            f"pairs of {known.min() / 1e3:.3g} to {known.max() / 1e3:.3g} kΩ" if known.size else "no pair conducts"
        )
        self._contacts = "; ".join([pairs, *(fault.words() for fault in faults)])
        return faults

    def _choose_current_A(self, ohm: Array) -> float:
        """Return the stated current if it leaves the headroom, else the largest round one that does."""
        known = np.where(np.isfinite(ohm), np.abs(ohm), 0.0)
        limit_V, free_percent = self._meter.compliance_V, self._options.headroom_percent
        most_A = self._largest_A
        if known.max() > 0:
            most_A = (1 - free_percent / 100) * limit_V / float(known.max())
        if self._options.current_mA is None:
            return _round_down(min(most_A, self._largest_A))
        stated_A = 1e-3 * self._options.current_mA
        if stated_A > most_A:
            source, sink = self._pattern.drive[int(known.argmax())]
            raise self._error(
                f"{1e3 * stated_A:g} mA need {stated_A * float(known.max()):.3g} V on pair {source}-{sink};"
                f" the source gives at most {limit_V:g} V, and {free_percent:g} % of that must stay free",
                f"state at most {1e3 * _round_down(most_A):g} mA, or raise compliance_V",
            )
        return stated_A


def _round_down(current_A: float) -> float:
    power = 10.0 ** np.floor(np.log10(current_A))
    step = max(step for step in _STEPS if step <= current_A / power * (1 + 1e-9))
    return float(f"{power * step:.2g}")


def _flag(reading: MeterReading) -> int:
    flag = ReadingFlag.NONE
    if reading.compliance:
        flag |= ReadingFlag.COMPLIANCE
    if reading.saturated:
        flag |= ReadingFlag.SATURATED
    return int(flag)
