"""The page of a calibration from labelled presses: presses left out, and how the sheet lies beneath them."""

import numpy as np

from cbsr_qa.calibration.presses import LabelledPresses, PressesLearned
from cbsr_qa.domain import Array
from cbsr_qa.domain.results import Figure, Section, SheetRegistration
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.report import fixed

_MAP = (
    "Left: presses in the frame of their labels, each with a line to where it was found when it was left out; the"
    " sheet is drawn where it is registered. Right: share of these presses inside regions that state to hold so many,"
    " which were sized by the other presses; dots on the line state what they hold, dots outside the band do not."
)


def press_sections(labelled: LabelledPresses, learned: PressesLearned) -> tuple[Section, ...]:
    """Lay out the errors of presses left out, and the coverage of their regions."""
    registration, out = learned.registration, learned.place.held_out
    places_mm = labelled.presses.place_mm[learned.used][out.presses]

    def draw() -> str:
        from cbsr_qa.report.draw import left_out_figure  # loads matplotlib

        sheet = _sheet_mm(labelled.sensor_type, registration) if registration.trusted else {}
        return left_out_figure(places_mm, out.found_mm, out.levels, out.held, **sheet)

    low, high = out.coverage
    alternative = (
        f"{out.count} presses left out, missed by {fixed(out.mean_mm, 2)} mm in the mean; regions of 68 and 95 % hold"
        f" {low:.0%} and {high:.0%} of them."
    )
    return (Section("Presses left out", (Figure(_MAP, alternative, draw),), page_only=True),)


def _sheet_mm(sensor_type: SensorType, pose: SheetRegistration) -> dict[str, Array]:
    angle = np.linspace(0, 2 * np.pi, 181)
    edge = pose.radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    electrodes = sensor_type.electrodes.positions_mm()
    beyond = 1.09 * pose.radius_mm * electrodes / np.linalg.norm(electrodes, axis=1, keepdims=True)
    return {"edge_mm": pose.labelled_mm(edge), "numbers_mm": pose.labelled_mm(beyond)}
