"""Checks a station's instruments one by one, then measures a ring of resistors with all of them; nothing moves."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from typing import Final

import numpy as np

from cbsr_qa.analysis.ring import RING, check_ring
from cbsr_qa.app.station_check.due_dates import check_due, check_standards
from cbsr_qa.app.station_check.ring import describe_connecting, simulates_frames, with_ring
from cbsr_qa.config.merging import Configuration
from cbsr_qa.domain.errors import AbortedError, CbsrError, InstrumentError, RefusedError
from cbsr_qa.domain.plan.plan import InstrumentSpec, ReferenceRing
from cbsr_qa.domain.plan.standards import StandardRole, find_standard
from cbsr_qa.domain.run.run import InstrumentIdentity
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult, RingReadings
from cbsr_qa.eit.forward.closed_forms import FEWEST_RESISTORS
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.failures import Interruption
from cbsr_qa.plugin.instruments import FrameSource, Instrument, Linked, Sampler, SelfTesting
from cbsr_qa.plugin.links.recorder import Listener
from cbsr_qa.plugin.links.replay import Replay
from cbsr_qa.plugin.links.taps import use_tap
from cbsr_qa.report.tables import list_names, number, unit_shown
from cbsr_qa.station.bench import (
    FORCE_APPLICATOR,
    FORCE_CHANNEL,
    FRAME_SOURCE,
    MULTIPLEXER,
    SOURCE_METER,
    Action,
    Bench,
    Mounted,
    identity_of,
    link_instruments,
    stop_all,
)
from cbsr_qa.station.setup import check_clock, opener
from cbsr_qa.system.clock import Clock
from cbsr_qa.system.copies import end_forked_copies

#: Function that is called with a request and returns whether the operator carried it out; None without an operator.
Confirm = Callable[[str], bool] | None

#: Subject of lines about all instruments together.
WHOLE_BENCH: Final = "whole bench"
#: What drives or switches a current, beside the source of frames.
_ELECTRICAL: Final = (SOURCE_METER, MULTIPLEXER)
#: What a bench needs for a run.
_NEEDED_ROLES: Final = (FRAME_SOURCE, FORCE_APPLICATOR, FORCE_CHANNEL)
_NO_RING: Final = "give --ring-ohm, or [reference_ring] in the station file"


class RecordingEnded(Interruption):
    """A check goes on where its transcript, which ends early, does not."""


@dataclass(slots=True)
class BenchFindings:
    """Lines of a check, instruments that answered, frames of the ring, and refusals to open an instrument."""

    lines: list[CheckResult] = field(default_factory=list)
    instruments: list[InstrumentIdentity] = field(default_factory=list)
    ring: RingReadings | None = None
    refused: list[RefusedError] = field(default_factory=list)


def look_at_bench(
    configuration: Configuration,
    plugins: Plugins,
    clock: Clock,
    *,
    today: date,
    ring: ReferenceRing | None,
    confirm: Confirm,
    ask: Callable[[str], str] | None = None,
    tell: Callable[[str], None] = lambda words: None,
    tap: Listener | Replay | None = None,
) -> BenchFindings:
    """Open every instrument, ask each for identity and self-test, check samples, measure the ring, close all.

    The bench is always made safe and closed. An instrument that does not answer is a line of the check.

    Parameters
    ----------
    ring : ring to measure, if any.
    confirm : called before the ring is measured on a real bench.
    ask : function that asks an operator to work instruments by hand; None without an operator.
    tap : recorder or replay of what passes between drivers and instruments, if any. Instruments that are replayed
        count as simulated.

    Raises
    ------
    ConfigError
        If the ring does not fit the sensor type, or an emulator cannot be started.
    """
    electrodes = configuration.sensor_type.electrodes.count
    resistances = () if ring is None or electrodes < FEWEST_RESISTORS else ring.resistances_ohm(electrodes)
    with_simulated_ring = (
        with_ring(configuration, resistances) if resistances and simulates_frames(configuration.station) else None
    )
    used_tap = tap or Listener(configuration.station)
    look = _Look(with_simulated_ring or configuration, clock, tell, used_tap)
    with use_tap(used_tap):
        opened, callbacks = opener(look.configuration, plugins, clock, ask=ask)
        try:
            for spec in sorted(look.configuration.station.instruments, key=_rank_movement):
                look.open(spec, opened, today)
            look.found.lines += check_standards(look.configuration.station, today)
            connected = with_simulated_ring is not None or (bool(resistances) and look.has_ring(resistances, confirm))
            look.put_together(callbacks)
            look.sample()
            look.measure_ring(ring, resistances, connected)
        except RecordingEnded as ended:
            look.skip_rest(str(ended), with_ring=ring is not None)
        except BaseException as error:
            used_tap.end_early(error)
            raise
        finally:
            look.close(callbacks)
    return look.found


def _rank_movement(spec: InstrumentSpec) -> int:
    """Order in which instruments are asked: what only reads first, then what drives a current, what moves last."""
    if FORCE_APPLICATOR in spec.provides:
        return 2
    return int(any(role in spec.provides for role in (FRAME_SOURCE, *_ELECTRICAL)))


class _Look:
    """One check of a bench: open instruments, and the findings so far."""

    def __init__(
        self, configuration: Configuration, clock: Clock, tell: Callable[[str], None], tap: Listener | Replay
    ) -> None:
        self.configuration = configuration
        self.found = BenchFindings()
        self._clock = clock
        self._tell = tell
        self._tap = tap
        self._mounted: list[Mounted] = []
        self._missing: list[InstrumentSpec] = []
        self._bench: Bench | None = None
        self._frame_source: FrameSource | None = None
        self._together = False
        self._skipped = False

    def open(self, spec: InstrumentSpec, opened: Callable[[InstrumentSpec], Instrument], today: date) -> None:
        self._tell(f"asking {spec.role}")
        try:
            mounted = Mounted(spec, opened(spec))
        except Exception as error:  # noqa: BLE001 - a plugin's driver may raise anything; it is one line
            if isinstance(error, RefusedError):
                self.found.refused.append(error)
            self._add(self._describe_error(spec.role, "identity", error))
            self._missing.append(spec)
        else:
            self._mounted.append(mounted)
            if not isinstance(mounted.instrument, Linked):
                self._ask(mounted)
        if spec.calibration_due is not None:
            self._add(check_due(spec.role, spec.calibration_due, self.configuration.station, today))

    def _ask(self, mounted: Mounted, *, emulated: bool = False) -> None:
        """Ask an instrument for identity and self-test; ``emulated`` as for :func:`identity_of`."""
        role = mounted.spec.role
        try:
            identity = identity_of(mounted, emulated=emulated or self._tap.replays)
        except Exception as error:  # noqa: BLE001 - as above
            self._add(self._describe_error(role, "identity", error))
            self._missing.append(mounted.spec)
            return
        self.found.instruments.append(identity)
        identity_parts = [
            identity.model,
            f"serial {identity.serial}" if identity.serial else "",
            f"firmware {identity.firmware}",
        ]
        known_parts = [part for part in identity_parts[: 3 if identity.firmware else 2] if part]
        simulation_notes = ["simulated"] if identity.simulated else []
        identity_words = ", ".join(
            [*known_parts, *(f"{what} {value}".strip() for what, value in identity.notes), *simulation_notes]
        )
        self._add(CheckResult("identity", CheckOutcome.OK, said=identity_words, subject=role))
        self._self_test(mounted)

    def _self_test(self, mounted: Mounted) -> None:
        if not isinstance(mounted.instrument, SelfTesting):
            reason = f"driver {mounted.spec.driver} has none"
            self._add(CheckResult("self-test", CheckOutcome.NOT_DONE, said=reason, subject=mounted.spec.role))
            return
        try:
            with end_forked_copies():
                tested = tuple(mounted.instrument.self_test())
            for line in tested:
                self._add(replace(line, subject=mounted.spec.role))
        except Exception as error:  # noqa: BLE001 - as above
            self._add(self._describe_error(mounted.spec.role, "self-test", error))

    def has_ring(self, resistances_ohm: tuple[float, ...], confirm: Confirm) -> bool:
        """Request the ring, before instruments that check their contacts are linked."""
        if self._missing:
            return False
        is_connected = confirm is not None and confirm(describe_connecting(resistances_ohm))
        if not is_connected:
            self._tap.note_no_ring()
        return is_connected

    def put_together(self, after: tuple[Action, ...]) -> None:
        """Build a bench if no instrument is missing, and query those that work through others."""
        linked_instruments = [mounted for mounted in self._mounted if isinstance(mounted.instrument, Linked)]
        if self._missing:
            for mounted in linked_instruments:
                reason, role = "it works through others, of which one is missing", mounted.spec.role
                self._add(CheckResult("identity", CheckOutcome.NOT_DONE, said=reason, subject=role))
            return
        provided = {role: mounted for mounted in self._mounted for role in mounted.spec.provides}
        lacking = [role for role in _NEEDED_ROLES if role not in provided]
        try:
            bench = None if lacking else Bench(self._mounted, after=after)
            if bench is None:
                said = f"no instrument provides {list_names(lacking)} yet, which every run needs"
                self._add(CheckResult("together", CheckOutcome.NOT_DONE, said=said, subject=WHOLE_BENCH))
                link_instruments(self._mounted, provided)
            emulates = any(mounted.spec.emulated for mounted in self._mounted)
            for mounted in linked_instruments:
                self._ask(mounted, emulated=emulates and "address" not in mounted.spec.options)
            if not self._missing:
                check_clock(self.configuration, self.found.instruments)
                self._bench, self._together = bench, True
                source = provided[FRAME_SOURCE].instrument if FRAME_SOURCE in provided else None
                self._frame_source = source if isinstance(source, FrameSource) else None
        except Exception as error:  # noqa: BLE001 - as above: linking calls drivers
            subject = error.role if isinstance(error, InstrumentError) else WHOLE_BENCH
            self._add(_error_result(subject, "together", error))

    def sample(self) -> None:
        """Check that every channel has samples within the allowed age of data."""
        if not self._together:
            return
        stale_s, begun_s = self.configuration.station.safety.stale_s, self._clock.now()
        self._clock.sleep(stale_s)
        for mounted in self._mounted:
            if isinstance(mounted.instrument, Sampler):
                try:
                    with end_forked_copies():
                        sampled = _check_samples(mounted.spec, mounted.instrument, begun_s, stale_s)
                    self._add(sampled)
                except Exception as error:  # noqa: BLE001 - as above
                    name = f"samples of {mounted.instrument.channel}"
                    self._add(self._describe_error(mounted.spec.role, name, error))

    def measure_ring(self, ring: ReferenceRing | None, resistances_ohm: tuple[float, ...], connected: bool) -> None:
        """Take frames of the ring and judge them; a line says why if none are taken."""
        sensor_type = self.configuration.sensor_type
        if ring is None:
            return self._add(_skip_ring("its resistances are not given, or --no-ring", _NO_RING))
        if not resistances_ohm:
            reason = f"{sensor_type.name} has {sensor_type.electrodes.count} electrodes; a ring needs at least three"
            return self._add(_skip_ring(reason, "set the station up for a sensor type with more"))
        if self._frame_source is None:
            together = self._together
            reason = "there is no source of frames yet" if together else "the instruments do not work together"
            return self._add(_skip_ring(reason, "" if together else "see above"))
        if not connected:
            reason = "it is not known whether the ring is connected"
            return self._add(_skip_ring(reason, "run it from a terminal, or with --ring-connected once it is"))
        self._tell("measuring the reference ring")
        try:
            with end_forked_copies():
                frames = self._frame_source.acquire(ring.frames)
        except Exception as error:  # noqa: BLE001 - as above
            return self._add(_error_result(RING, "readings", error))
        self.found.ring = RingReadings(frames, resistances_ohm)
        self.found.lines += check_ring(self.found.ring, sensor_type.pattern, ring)
        meter = find_standard(self.configuration.station.standards, StandardRole.SOURCE_METER)
        current_mA = 1e3 * (frames.current_A or 0.0)
        if meter is not None and current_mA and not meter.covers(current_mA):
            said = f"{current_mA:.3g} mA were driven; certificate {meter.certificate} covers {meter.range_words()}"
            remedy, subject = "drive a current that it covers: others get no U", f"standards.{meter.role}"
            self._add(CheckResult("range", CheckOutcome.FAILED, said=said, remedy=remedy, subject=subject))
        return None

    def skip_rest(self, reason: str, *, with_ring: bool) -> None:
        """Add a line for all that was not looked at, because the transcript ends early."""
        asked = {line.subject for line in self.found.lines if line.name == "identity"}
        roles = [spec.role for spec in self.configuration.station.instruments]
        skipped = [(role, "identity") for role in roles if role not in asked]
        skipped += [(RING, "readings")] if with_ring and self.found.ring is None else []
        for subject, name in (*skipped, (WHOLE_BENCH, "safe state")):
            self._add(CheckResult(name, CheckOutcome.NOT_DONE, said=reason, subject=subject))
        self._skipped = True

    def close(self, after: tuple[Action, ...]) -> None:
        """Make everything safe and close it; a failure is a line."""
        if self._bench is not None:
            unsafe, unclosed = self._bench.safe_state(), self._bench.close()
        else:
            unsafe = stop_all([(mounted.name, mounted.instrument.safe_state) for mounted in self._mounted])
            unclosed = stop_all([*((mounted.name, mounted.instrument.close) for mounted in self._mounted), *after])
        if self._tap.ended:
            if not self._skipped:
                self.skip_rest(self._tap.ended, with_ring=False)
            return
        for name, problems in (("safe state", unsafe), ("closing", unclosed)):
            for problem in problems:
                remedy = "switch the source off and lift the head by hand, then check this instrument"
                if self._tap.replays:
                    remedy = ""
                said = problem.replace("\n", "; ")
                self._add(CheckResult(name, CheckOutcome.FAILED, said=said, remedy=remedy, subject=WHOLE_BENCH))
        silent_roles = [spec.role for spec in self._missing if _rank_movement(spec)]
        if silent_roles:
            said = f"not known for {list_names(silent_roles)}: no answer"
            remedy = "" if self._tap.replays else "look at the bench: the source must be off, and the head up"
            self._add(CheckResult("safe state", CheckOutcome.WARNING, said=said, remedy=remedy, subject=WHOLE_BENCH))
        elif self._mounted and not unsafe:
            said = _describe_safe(self._mounted)
            self._add(CheckResult("safe state", CheckOutcome.OK, said=said, subject=WHOLE_BENCH))

    def _describe_error(self, role: str, name: str, error: Exception) -> CheckResult:
        """Return the line of an error, with what was sent last and what came then."""
        line = _error_result(role, name, error)
        last = self._tap.describe_last(role)
        return replace(line, said=f"{line.said}; {last}") if last else line

    def _add(self, line: CheckResult) -> None:
        self.found.lines.append(line)


def _describe_safe(mounted: Sequence[Mounted]) -> str:
    """Say which instruments report what is safe. A source of frames may have a current that nothing switches."""
    reports = []
    for said, role in (("source off", SOURCE_METER), ("head up", FORCE_APPLICATOR)):
        names = [one.spec.role for one in mounted if role in one.spec.provides]
        reports += [f"{said} ({list_names(names)})"] if names else []
    return f"reported: {', '.join(reports)}" if reports else "every instrument says that it is safe"


def _error_result(subject: str, name: str, error: Exception) -> CheckResult:
    """Return the line of an error; an operator's stop is raised again."""
    if isinstance(error, AbortedError):
        raise error
    if isinstance(error, CbsrError):
        return CheckResult(name, CheckOutcome.FAILED, said=error.reason, remedy=error.remedy, subject=subject)
    finding = f"{type(error).__name__}: {error}"
    return CheckResult(
        name, CheckOutcome.FAILED, said=finding, remedy="report it to the driver's author", subject=subject
    )


def _skip_ring(why: str, remedy: str) -> CheckResult:
    return CheckResult("readings", CheckOutcome.NOT_DONE, said=why, remedy=remedy, subject=RING)


def _check_samples(spec: InstrumentSpec, sampler: Sampler, begun_s: float, stale_s: float) -> CheckResult:
    block, name = sampler.samples_since(begun_s), f"samples of {sampler.channel}"
    if not len(block) and FORCE_APPLICATOR in spec.provides and sampler.channel != FORCE_CHANNEL:
        reason = "it says where the head is while that moves, and nothing moved"
        return CheckResult(name, CheckOutcome.NOT_DONE, said=reason, subject=spec.role)
    finite = bool(len(block)) and bool(np.isfinite(block.values).all())
    finding = f"no sample in {stale_s:g} s"
    if len(block):
        mean, deviation = float(block.values.mean()), float(block.values.std())
        shown_unit = unit_shown(block.unit)
        finding = f"mean {number(mean)} {shown_unit}, standard deviation {number(deviation, 2)} {shown_unit}"
    return CheckResult(
        name,
        CheckOutcome.OK if finite else CheckOutcome.FAILED,
        value=len(block) / stale_s,
        unit="1/s",
        allowed=f"at least one in {stale_s:g} s",
        said=finding if finite or not len(block) else "a sample is not a finite number",
        remedy="" if finite else "check its cable and supply",
        subject=spec.role,
    )
