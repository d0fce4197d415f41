"""The outcome of ``cbsr-qa calibration show`` for a calibration from labelled presses."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from cbsr_qa.app.calibration.calibrate import HeldOut, press_facts
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.plan.standards import ReferenceStandard, describe_force_error
from cbsr_qa.domain.results.press_calibration import LeftOutPress, PressCalibration, SheetRegistration, SourceFile
from cbsr_qa.domain.results.report import Banner, CommandOutcome
from cbsr_qa.report.page import answer

_NO_BUDGET: Final = "no budget is made of forces that are learned from labelled presses"


@dataclass(frozen=True, slots=True)
class ShownPressCalibration:
    """Contents of a calibration from labelled presses, without its arrays.

    Parameters
    ----------
    made_by : states that no station made it.
    sources : files it was made from, with their SHA-256.
    force_error : what errors of force include.
    no_expanded_forces : why no expanded uncertainty is stated.
    standards : reference standards that the presses stated.
    readings : distinct ones; ``rest`` whether changes refer to its own unloaded frames.
    """

    file: Path
    digest: str
    calibration: str
    issued_at: str
    made_by: str
    sensor_type: str
    electrodes: int
    sources: tuple[SourceFile, ...]
    readings: int
    differences: bool
    used: int
    left_out: tuple[LeftOutPress, ...]
    registration: SheetRegistration
    held_out: HeldOut
    force_error: str
    no_expanded_forces: str
    standards: tuple[ReferenceStandard, ...]
    findings: tuple[str, ...]


def press_calibration_outcome(path: Path, held: PressCalibration) -> CommandOutcome[ShownPressCalibration]:
    """Return the contents of a calibration from labelled presses."""
    shown_calibration = fill_from_object(
        ShownPressCalibration,
        held,
        file=path,
        readings=len(held.pairs),
        registration=held.registration,
        held_out=HeldOut.from_calibration(held),
        force_error=describe_force_error(held.standards),
        no_expanded_forces=_NO_BUDGET,
    )
    facts = [
        ("Issued at", held.issued_at),
        ("Made by", held.made_by),
        ("Calibration", held.calibration),
        (
            "Readings",
            f"{shown_calibration.readings}, {'changes' if held.differences else 'against its own unloaded frames'}",
        ),
        *((f"From {source.role}", f"{source.name}, SHA-256 {source.digest}") for source in held.sources),
        *press_facts(held),
        ("Expanded uncertainty", f"none: {_NO_BUDGET}"),
    ]
    outcome = answer(shown_calibration, "", "", facts, [("SHA-256", held.digest)], held.findings)
    banner = Banner("plain", "●", f"Calibration of a {held.sensor_type} from labelled presses", "")
    return replace(outcome, page=replace(outcome.page, kind="Calibration", banner=banner))
