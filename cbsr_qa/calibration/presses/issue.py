"""Issue of a calibration from labelled presses."""

from dataclasses import dataclass
from typing import Final

from cbsr_qa.calibration.file.hdf5 import stamp
from cbsr_qa.calibration.presses.inputs import LabelledPresses
from cbsr_qa.calibration.presses.learning import PressesLearned
from cbsr_qa.domain.plan.standards import ReferenceStandard
from cbsr_qa.domain.results.press_calibration import LeftOutPress, PressCalibration, SourceFile

_MADE_BY: Final = "labelled presses; no station made this calibration"


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity of a calibration.

    Parameters
    ----------
    calibration : time-ordered UUID as text.
    issued_at : ISO time with zone.
    sources : input files.
    """

    calibration: str
    issued_at: str
    sources: tuple[SourceFile, ...]


def issue_from_presses(
    identity: Identity,
    labelled: LabelledPresses,
    learned: PressesLearned,
    standards: tuple[ReferenceStandard, ...] = (),
) -> PressCalibration:
    """Issue a calibration learned from labelled presses.

    Parameters
    ----------
    standards : reference standards that the forces of the presses are traced to.
    """
    sensor_type, readings, distinct = labelled.sensor_type, labelled.readings, labelled.readings.distinct
    held_out = learned.place.held_out
    return stamp(
        PressCalibration(
            calibration=identity.calibration,
            issued_at=identity.issued_at,
            made_by=_MADE_BY,
            sensor_type=sensor_type.name,
            electrodes=sensor_type.electrodes.count,
            sources=identity.sources,
            differences=readings.rest is None,
            pairs=distinct.pairs,
            repeats=distinct.repeats,
            rest=readings.rest,
            noise=readings.noise,
            registration=learned.registration,
            findings=learned.findings,
            used=int(learned.used.sum()),
            left_out=tuple(LeftOutPress(row + 1, why) for row, why in enumerate(learned.why_not) if why),
            held_out_mm=held_out.mean_mm,
            held_out_stderr_mm=held_out.stderr_mm,
            held_out=held_out.count,
            covered_68=None if held_out.coverage is None else held_out.coverage[0],
            covered_95=None if held_out.coverage is None else held_out.coverage[1],
            place=learned.place.model,
            modelled=learned.modelled,
            force=learned.quantities.get("force"),
            depth=learned.quantities.get("depth"),
            drive=sensor_type.pattern.drive,
            measure=sensor_type.pattern.measure,
            standards=standards,
        )
    )
