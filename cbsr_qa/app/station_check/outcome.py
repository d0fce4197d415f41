"""The outcome of ``cbsr-qa station check``: its lines, and the ring against its closed form."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Final

from cbsr_qa.analysis.ring import RING, fit_ring
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.plan.plan import ReferenceRing
from cbsr_qa.domain.results.report import Banner, Block, CommandOutcome, Page, Paragraph, Section
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult, RingReadings, StationCheck
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.report.draw.channels import ring_figure
from cbsr_qa.report.station import count_results, lines_table, remedies
from cbsr_qa.report.tables import plural, quantity, text_table
from cbsr_qa.system.clock import write_local_time

_RING_WORDS: Final = (
    "A ring of resistors between neighbouring electrodes stands in place of the sensor. What every pair must read of "
    "it follows from Kirchhoff's laws alone: between two electrodes lie two arcs in parallel. All readings together "
    "are fitted by a gain, an offset and a resistance of each lead; the residual of a reading is its own error."
)
_GOLDEN_WORDS: Final = (
    "A golden sensor is kept for checks of stations. Its values are compared with its earlier runs, separately for "
    "this station and for others. Each interval is where one further run would lie; if nothing has changed, all "
    "values lie within their intervals with 99 % probability. A value outside fails, one outside those of 95 % warns."
)


@dataclass(frozen=True, slots=True)
class AnsweringInstrument:
    """See :class:`~cbsr_qa.domain.run.run.InstrumentIdentity`."""

    role: str
    driver: str
    model: str
    serial: str
    firmware: str
    simulated: bool
    calibration_due: str | None
    notes: dict[str, str]


@dataclass(frozen=True, slots=True)
class CheckedStation:
    """A stored check of a station; ``page_why`` says why there is no ``page``, ``transcript_why`` why no transcript.

    Parameters
    ----------
    transcript : file of ``station record``; None if nothing was recorded, or not all.
    """

    check: str
    station: str
    operator: str
    checked_at: datetime
    outcome: CheckOutcome
    results: tuple[CheckResult, ...]
    instruments: tuple[AnsweringInstrument, ...]
    golden_run: str | None
    configuration_digest: str
    page: Path | None = None
    page_why: str = ""
    transcript: Path | None = None
    transcript_why: str = ""


def check_outcome(
    check: StationCheck,
    ring: RingReadings | None,
    pattern: DrivePattern,
    allowed: ReferenceRing | None,
    *,
    golden_run: str = "",
) -> CommandOutcome[CheckedStation]:
    """Lay out a check; the exit code is 1 if something failed, and 3 if no instrument answered.

    Parameters
    ----------
    ring, allowed : its frames and their limits; None if not measured.
    golden_run : its name for people; empty if not run.
    """
    instruments = tuple(
        fill_from_object(AnsweringInstrument, instrument, notes=dict(instrument.notes))
        for instrument in check.instruments
    )
    checked = fill_from_object(CheckedStation, check, instruments=instruments)
    code = 3 if not instruments else 1 if check.outcome is CheckOutcome.FAILED else 0
    return CommandOutcome(
        checked, _compose_head(check, golden_run), tuple(_list_sections(check, ring, pattern, allowed)), code
    )


def _compose_head(check: StationCheck, golden_run: str) -> Page:
    failed = check.lines(CheckOutcome.FAILED)
    if failed:
        reason = "; ".join(f"{line.subject}: {line.name}" for line in failed)
        banner = Banner("fail", "✗", "FAILED", reason)
    elif check.outcome is CheckOutcome.WARNING:
        banner = Banner("marginal", "≈", "OK, with warnings", count_results(check))
    else:
        banner = Banner("pass", "✓", "OK", f"{plural(len(check.lines(CheckOutcome.OK)), 'check')} passed")
    facts = (
        ("Station", check.station),
        ("Checked", write_local_time(check.checked_at)),
        ("Operator", check.operator or "not stated"),
        ("Set up for", check.sensor_type),
        ("Check", check.check),
        ("Golden run", golden_run or "none"),
        ("Configuration digest", check.configuration_digest),
    )
    simulated = tuple(
        f"{instrument.role}: {instrument.model}" for instrument in check.instruments if instrument.simulated
    )
    return Page("Station check", check.station, banner, facts, simulated, ())


def _list_sections(
    check: StationCheck, ring: RingReadings | None, pattern: DrivePattern, allowed: ReferenceRing | None
) -> list[Section]:
    of_ring = [line for line in check.results if line.subject == RING]
    of_golden = [line for line in check.results if line.subject.startswith("golden")]
    other_lines = [line for line in check.results if line not in of_ring and line not in of_golden]
    todo = remedies(check.results)
    sections = [Section("What to do", todo)] if todo else []
    sections.append(Section("Instruments", (lines_table("Checks of the instruments.", other_lines),)))
    if of_ring:
        sections.append(Section("Reference ring", _describe_ring(of_ring, ring, pattern, allowed)))
    if of_golden:
        caption = "The golden sensor's values against its history."
        sections.append(Section("Golden sensor", (Paragraph(_GOLDEN_WORDS), lines_table(caption, of_golden))))
    versions = text_table("Versions.", ("Distribution", "Version"), check.software)
    sections.append(Section("Software", (versions,), page_only=True))
    return sections


def _describe_ring(
    lines: Sequence[CheckResult], ring: RingReadings | None, pattern: DrivePattern, allowed: ReferenceRing | None
) -> tuple[Block, ...]:
    blocks: list[Block] = [Paragraph(_RING_WORDS)]
    if ring is not None and allowed is not None:
        current = ring.frames.current_A
        current_text = "an unknown current" if current is None else quantity(current, "A")
        low, high = min(ring.resistances_ohm), max(ring.resistances_ohm)
        ohm = quantity(low, "ohm") if low == high else f"{quantity(low, 'ohm')} to {quantity(high, 'ohm')}"
        blocks.append(
            Paragraph(f"{len(ring.resistances_ohm)} resistors of {ohm}, {len(ring.frames)} frames at {current_text}.")
        )
        blocks += _draw_ring(ring, pattern, allowed)
    return (*blocks, lines_table("Checks with the reference ring.", lines))


def _draw_ring(ring: RingReadings, pattern: DrivePattern, allowed: ReferenceRing) -> list[Block]:
    try:
        fit = fit_ring(ring, pattern)
    except NumericsError:
        return []  # its line says why
    limit = allowed.reading + allowed.tolerance
    return [
        ring_figure(
            fit.expected,
            fit.mean,
            fit.residual,
            driven=~pattern.usable(),
            used=fit.used,
            allowed=limit,
            unit=str(ring.frames.unit),
        )
    ]
