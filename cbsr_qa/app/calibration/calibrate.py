"""``cbsr-qa calibrate``: a calibration from labelled presses, wherever they were made."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np

from cbsr_qa.analysis.recording.press_files import PressFiles, read_labelled_presses
from cbsr_qa.app.calibration.file import check_free
from cbsr_qa.calibration.file.hdf5 import write_calibration
from cbsr_qa.calibration.presses.inputs import LabelledPresses, find_outline
from cbsr_qa.calibration.presses.issue import Identity, issue_from_presses
from cbsr_qa.calibration.presses.learning import PressesLearned, learn_presses
from cbsr_qa.calibration.presses.tables import source_file
from cbsr_qa.config.loader import load_standards
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.standards import ReferenceStandard, StandardRole, describe_force_error, find_doubtful_dates
from cbsr_qa.domain.results.learned_quantity import LearnedQuantity
from cbsr_qa.domain.results.press_calibration import (
    PRESS_QUANTITIES,
    LeftOutPress,
    PressCalibration,
    SheetRegistration,
)
from cbsr_qa.domain.results.report import Banner, CommandOutcome, Figure, Section
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.report.page import answer
from cbsr_qa.report.tables import format_fixed, plural, with_uncertainty
from cbsr_qa.store.types import IdSource

#: Rows left out that a terminal shows.
_MOST_ROWS: Final = 10
#: Points of a drawn edge.
_EDGE_POINTS: Final = 401
#: Distance of electrode numbers from the electrodes, of the sheet's radius.
_NUMBERS_BEYOND: Final = 0.13


@dataclass(frozen=True, slots=True)
class HeldOutPlaces:
    """Error of place of presses left out [mm]: mean, its standard error, and their number.

    Parameters
    ----------
    not_counted : why ``n`` is not the number of presses that were used; None if it is.
    """

    mean: float | None
    stderr: float | None
    n: int
    not_counted: str | None


@dataclass(frozen=True, slots=True)
class HeldOutQuantity:
    """Absolute error of force [N] or depth [mm] of presses left out: mean, its standard error, and their number.

    Parameters
    ----------
    coverage : share of them whose interval of 68 and 95 % holds the label; None if their places are too few to tell.
    not_counted : why ``n`` is not the number of presses that were used; None if it is.
    """

    mean: float
    stderr: float
    n: int
    coverage: dict[str, float | None]
    not_counted: str | None

    @classmethod
    def from_learned(cls, learned: LearnedQuantity | None, issued: PressCalibration) -> "HeldOutQuantity | None":
        if learned is None:
            return None
        shares = (None, None) if issued.covered_68 is None else learned.covered.tolist()
        coverage: dict[str, float | None] = dict(zip(("68", "95"), shares, strict=True))
        kept = len(learned.values)
        thinned = f"{kept} are kept, evenly over the session" if kept < issued.used else None
        reasons = "; ".join(why for why in (thinned, _describe_recheck(issued)) if why)
        count = kept - _count_recheck(issued)
        return cls(learned.error, learned.error_stderr, count, coverage, reasons or None)


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Errors estimated from presses left out.

    Parameters
    ----------
    coverage : share of the presses left out whose region of 68 and 95 % holds the label; None if they are too few to
        tell how wide regions are.
    force_N, depth_mm : None where presses had none.
    """

    place_mm: HeldOutPlaces
    coverage: dict[str, float | None]
    force_N: HeldOutQuantity | None
    depth_mm: HeldOutQuantity | None

    @classmethod
    def from_calibration(cls, issued: PressCalibration) -> "HeldOut":
        places = HeldOutPlaces(
            issued.held_out_mm, issued.held_out_stderr_mm, issued.held_out, _describe_recheck(issued)
        )
        coverage = {"68": issued.covered_68, "95": issued.covered_95}
        force, depth = (HeldOutQuantity.from_learned(each, issued) for each in (issued.force, issued.depth))
        return cls(places, coverage, force, depth)


def _count_recheck(issued: PressCalibration) -> int:
    """Number of presses that were used, but have no part in errors."""
    return 0 if issued.held_out_mm is None else issued.used - issued.held_out


def _describe_recheck(issued: PressCalibration) -> str | None:
    count = _count_recheck(issued)
    return f"without a re-check of {plural(count, 'press', 'presses')}, whose errors widen regions" if count else None


@dataclass(frozen=True, slots=True)
class Labels:
    """Whether readings and labels seem to belong together by their rows.

    Parameters
    ----------
    suspected : what seems to have happened to the tables; None if nothing is suspected.
    gain_mm : by how much less a press is missed in the rows' likely order; None if nothing is suspected.
    """

    suspected: str | None
    gain_mm: float | None


@dataclass(frozen=True, slots=True)
class PressesCalibrated:
    """A calibration that was issued from labelled presses.

    Parameters
    ----------
    calibration : file of the calibration.
    used, left_out : presses that it was, and was not, learned from; rows are counted from 1 below the header.
    explained : share of the readings' changes that the modelled sheet explains.
    place_learned : whether presses left out are missed by clearly less than by guessing.
    force_error : what errors of force include.
    standards : reference standards that are stated.
    """

    calibration: Path
    used: int
    left_out: tuple[LeftOutPress, ...]
    explained: float
    registration: SheetRegistration
    held_out: HeldOut
    warnings: tuple[str, ...]
    digest: str
    size_bytes: int
    place_learned: bool
    labels: Labels
    force_error: str
    standards: tuple[ReferenceStandard, ...]


def calibrate_from_presses(
    files: PressFiles,
    to: Path,
    *,
    standards: Path | None = None,
    tell: Callable[[str], None] = lambda stage: None,
) -> CommandOutcome[PressesCalibrated]:
    """Calibrate places from labelled presses and write the calibration.

    Parameters
    ----------
    to : calibration file to write; must not exist.
    standards : file with the reference standards that the forces are traced to, or of a station that states them.

    Raises
    ------
    RefusedError
        If a table, the pattern, the sensor type, the standards or the output path cannot be used; nothing is written
        then.
    """
    check_free(to)
    stated = () if standards is None else load_standards(standards).value
    tell("reading the tables")
    labelled, sources = read_labelled_presses(files)
    if standards is not None:
        sources = (*sources, source_file("standards", standards))
    identity = Identity(
        IdSource(lambda: datetime.now(UTC)).new(), datetime.now(UTC).isoformat(timespec="seconds"), sources
    )
    learned = learn_presses(labelled, tell=tell)
    doubts = tuple(_doubt_standards(stated, learned))
    issued = issue_from_presses(identity, labelled, replace(learned, findings=(*learned.findings, *doubts)), stated)
    write_calibration(to, issued)
    return replace(_outcome(issued, learned, to), sections=_sections(labelled, learned))


def _doubt_standards(standards: tuple[ReferenceStandard, ...], learned: PressesLearned) -> Iterator[str]:
    """Yield what is odd about the stated standards."""
    yield from find_doubtful_dates(standards, datetime.now(UTC).date())
    if standards and "force" not in learned.quantities:
        yield "the presses have no force_N: the stated standards are kept, and nothing depends on them"


def _outcome(issued: PressCalibration, learned: PressesLearned, file: Path) -> CommandOutcome[PressesCalibrated]:
    result = PressesCalibrated(
        calibration=file,
        used=issued.used,
        left_out=issued.left_out,
        explained=issued.registration.signal_share,
        registration=issued.registration,
        held_out=HeldOut.from_calibration(issued),
        warnings=issued.findings,
        digest=issued.digest,
        size_bytes=file.stat().st_size,
        place_learned=learned.place_learned,
        force_error=describe_force_error(issued.standards),
        standards=issued.standards,
        labels=Labels(None, None)
        if learned.row_order is None
        else Labels(learned.row_order.words, learned.row_order.gain_mm),
    )
    reason = f"{plural(issued.used, 'press', 'presses')} of a {issued.sensor_type}"
    printed = (("Calibration", str(file)),)
    outcome = answer(result, "calibrated", reason, press_facts(issued), printed, issued.findings)
    page = replace(outcome.page, kind="Calibration from presses", subject=file.name)
    if learned.place_learned:
        return replace(outcome, page=page)
    missed = with_uncertainty(learned.place.held_out.mean_mm, learned.place.held_out.stderr_mm)
    reason = f"presses left out are missed by {missed} mm, by guessing the middle by {learned.guess_mm:.3g} mm"
    return replace(outcome, page=replace(page, banner=Banner("fail", "✗", "place not learned", reason)), exit_code=1)


def press_facts(issued: PressCalibration) -> list[tuple[str, str]]:
    """Return facts about a calibration from labelled presses, as (name, value)."""
    facts = [("Presses", f"{issued.used} used, {len(issued.left_out)} left out")]
    held_out = HeldOut.from_calibration(issued)
    if issued.held_out_mm is not None:
        error = _with(issued.held_out_mm, issued.held_out_stderr_mm, 2)
        facts.append(("Error of place", f"{error} mm, {_format_count(held_out.place_mm)}"))
    if issued.covered_68 is not None and issued.covered_95 is not None:
        facts.append(("Regions hold the place", _format_coverage(issued.covered_68, issued.covered_95)))
    for name, unit in PRESS_QUANTITIES.items():
        quantity: HeldOutQuantity | None = getattr(held_out, f"{name}_{unit}")
        if quantity is not None:
            error = f"{with_uncertainty(quantity.mean, quantity.stderr)} {unit}"
            facts.append((f"Error of {name}", f"{error}, {_format_count(quantity)}"))
            low, high = quantity.coverage.values()
            if low is not None and high is not None:
                facts.append((f"Intervals hold the {name}", _format_coverage(low, high)))
    if issued.force is not None:
        facts.append(("Errors of force include", describe_force_error(issued.standards)))
    for head in (standard for standard in issued.standards if standard.role == StandardRole.INDENTER):
        facts.append(("Head", f"{head.words()}; no force of this calibration depends on it"))
    if issued.registration.trusted:
        explained = f"{100 * issued.registration.signal_share:.0f} % of the readings' changes"
        facts.append(("Explained by the model", explained))
        facts.append(("Sheet", _pose_words(issued.registration)))
    else:
        facts.append(("Sheet", "its pose is not known; the place is learned from the presses alone"))
    return facts + [(f"Row {each.row} left out", each.why) for each in issued.left_out[:_MOST_ROWS]]


def _format_count(held_out: HeldOutPlaces | HeldOutQuantity) -> str:
    mean = f"mean of {plural(held_out.n, 'press', 'presses')} left out"
    return f"{mean}: {held_out.not_counted}" if held_out.not_counted else mean


def _format_coverage(low: float, high: float) -> str:
    return f"{100 * low:.0f} % (asked 68 %), {100 * high:.0f} % (asked 95 %)"


def _pose_words(pose: SheetRegistration) -> str:
    x, y = (_with(*each, 1) for each in zip(pose.shift_mm, pose.shift_stderr_mm, strict=True))
    sentence = f"centre at ({x}, {y}) mm, turned by {_with(pose.rotation_deg, pose.rotation_stderr_deg, 1)}°"
    sentence += f"{', mirrored' if pose.mirrored else ''}, scale {_with(pose.scale, pose.scale_stderr, 3)}"
    sentence += f", radius {_with(pose.radius_mm, pose.radius_stderr_mm, 1)} mm"
    return sentence


def _with(value: float, stderr: float | None, digits: int) -> str:
    return with_uncertainty(value, stderr) if stderr else format_fixed(value, digits)


_MAP = (
    "Left: presses in the frame of their labels, each with a line to where it was found when it was left out; the"
    " sheet is drawn where it is registered. Right: share of these presses inside regions that state to hold so many,"
    " which were sized by the other presses; dots on the line state what they hold, dots outside the band do not."
)


def _sections(labelled: LabelledPresses, learned: PressesLearned) -> tuple[Section, ...]:
    """Lay out the errors of presses left out, and the coverage of their regions."""
    registration, cv = learned.registration, learned.place.held_out
    places_mm = labelled.presses.place_mm[learned.used][cv.presses]

    def draw() -> str:
        from cbsr_qa.report.draw.presses import cross_validation_figure  # loads matplotlib

        sheet = _sheet_mm(labelled.sensor_type, registration) if registration.trusted else {}
        return cross_validation_figure(places_mm, cv.found_mm, cv.levels, cv.held, **sheet)

    regions = "they do not tell how wide regions are."
    if cv.coverage is not None:
        regions = "regions of 68 and 95 % hold {:.0%} and {:.0%} of them.".format(*cv.coverage)
    missed = f"{cv.count} presses left out, missed by {format_fixed(cv.mean_mm, 2)} mm in the mean"
    alternative = f"{missed}; {regions}"
    return (Section("Presses left out", (Figure(_MAP, alternative, draw),), page_only=True),)


def _sheet_mm(sensor_type: SensorType, pose: SheetRegistration) -> dict[str, Array]:
    curve = find_outline(sensor_type, pose).curve
    edge = curve.points_at(np.linspace(0, curve.perimeter, _EDGE_POINTS))
    electrodes = sensor_type.electrodes.positions_mm()
    beyond = electrodes * (1 + _NUMBERS_BEYOND * pose.radius_mm / np.linalg.norm(electrodes, axis=1, keepdims=True))
    return {"edge_mm": pose.to_press_frame_mm(edge), "numbers_mm": pose.to_press_frame_mm(beyond)}
