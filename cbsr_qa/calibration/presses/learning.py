"""Learning from labelled presses: pose of the sheet, place, force and depth, and what may be wrong."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cbsr_qa.calibration.place.faulty import Modelled
from cbsr_qa.calibration.place.features import ring_axes
from cbsr_qa.calibration.place.learning import PlaceLearned, learn_place
from cbsr_qa.calibration.place.modelled import ModelledEstimator, with_variance
from cbsr_qa.calibration.place.quantity import is_untold, learn_quantity
from cbsr_qa.calibration.presses.dead_readings import estimate_clipped_share, find_dead_readings
from cbsr_qa.calibration.presses.electrode_order import ElectrodeOrder, find_electrode_order
from cbsr_qa.calibration.presses.inputs import LabelledPresses, check_inside, find_outline
from cbsr_qa.calibration.presses.likeness import answering_side
from cbsr_qa.calibration.presses.odd_labels import (
    list_ignored_columns,
    list_unused_electrodes,
    name_far_from_labels,
    name_off_sheet,
)
from cbsr_qa.calibration.presses.row_order import RowOrder, find_row_order, guess_error
from cbsr_qa.calibration.presses.weak_loads import STEP, ModelledSheet
from cbsr_qa.domain.errors import CalibrationError, NumericsError, RecordingError
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.results.learned_place import ModelledPlace
from cbsr_qa.domain.results.learned_quantity import LearnedQuantity
from cbsr_qa.domain.results.press_calibration import (
    PRESS_QUANTITIES,
    SheetRegistration,
)
from cbsr_qa.domain.sensor.electrodes import ElectrodeLayout
from cbsr_qa.domain.sensor.sensor_type import SensorType

#: Largest difference of the scale from 1 that errors of mounting and modelling explain.
_MAX_SCALE_ERROR: Final = 0.1
#: Least extent of all presses; if it is smaller, their places are taken to be in another unit than millimetres.
_MIN_EXTENT_MM: Final = 1.0
#: Largest excess of a frame's mean square over that of its noise by chance, in standard deviations.
_NOISE_DEVIATIONS: Final = 3.3
#: Readings hardly tell a quantity if its error exceeds this share of the error of always guessing the median.
_UNINFORMATIVE_SHARE: Final = 0.6
#: Places are learned if their error is below this share of the error of guessing.
_LEARNED_SHARE: Final = 0.9
#: Other orders of the rows are tried if the error is above this share of the error of guessing.
DOUBTFUL_SHARE: Final = 0.3
_MIRRORED: Final = (
    "the sheet is mirrored against its sensor type: it is seen from below, or its electrodes are numbered the other"
    " way round"
)
_ORDERED_BY_PLACE: Final = (
    "presses were made in the order of their places: drift of the readings would look like another place, and presses"
    " left out would not show it; press in random order, or at some places again at the end"
)

Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class PressesLearned:
    """Results of learning from labelled presses.

    Parameters
    ----------
    findings : sentences on readings, electrodes and sheet.
    used : (n,) mask of the presses that were used. Left-out presses are numbered among those used.
    why_not : (n,) reason why a press was not used; empty for those that were.
    guess_mm : mean distance of the presses left out from the median of all: the error of guessing.
    row_order : order of rows in which readings and labels fit clearly better; None without one.
    modelled : place by the modelled sheet alone.
    quantities : force and depth by their names, where the presses have them.
    """

    registration: SheetRegistration
    findings: tuple[str, ...]
    used: Mask
    why_not: tuple[str, ...]
    place: PlaceLearned
    guess_mm: float
    row_order: RowOrder | None
    modelled: ModelledPlace
    quantities: Mapping[str, LearnedQuantity]

    @property
    def place_learned(self) -> bool:
        """Whether presses left out are missed by clearly less than by guessing."""
        held_out = self.place.held_out
        return held_out.mean_mm + 2 * held_out.stderr_mm < _LEARNED_SHARE * self.guess_mm


def learn_presses(labelled: LabelledPresses, *, tell: Tell = lambda stage: None) -> PressesLearned:
    """Register a sheet to its labelled presses, and learn place, force and depth from them.

    Parameters
    ----------
    tell : receives the progress in words.

    Raises
    ------
    RecordingError
        If readings and labels do not match, the places do not determine the sheet's pose, or presses are outside it.
    CalibrationError
        If there are too few presses.
    """
    readings, presses = labelled.readings, labelled.presses
    labelled.check()
    tell("finding how the sheet lies")
    dead_readings = find_dead_readings(
        readings.distinct.pairs,
        readings.changes,
        presses.place_mm,
        readings.rest,
        readings.noise,
        readings.columns,
    )
    clipped_share = estimate_clipped_share(readings.changes, readings.rest)
    readings = replace(readings, changes=np.where(dead_readings.dead, 0.0, readings.changes))
    sheet = ModelledSheet(labelled.sensor_type)
    order = _find_electrode_order(replace(labelled, readings=readings), sheet)
    registration = order.registered.registration
    outline = find_outline(labelled.sensor_type, registration)
    if registration.trusted:
        check_inside(presses, registration, outline)
    used_mask = np.any(readings.changes != 0, axis=1)
    time_s = None if presses.time_s is None else presses.time_s[used_mask]
    place_mm, missing = presses.place_mm[used_mask], dead_readings.dead[used_mask]
    learned_place = _learn_place(
        labelled.sensor_type,
        order,
        readings.changes[used_mask],
        place_mm,
        time_s,
        missing,
        _expect_changes(sheet, order, readings.changes, used_mask) if registration.trusted else None,
        tell,
    )
    if readings.noise is not None:
        noise = np.where(learned_place.model.scaling.ceiling > 0, readings.noise, 0.0)  # noise of the used readings
        least = max(learned_place.model.least_size, noise_size(noise))
        learned_place = replace(learned_place, model=replace(learned_place.model, least_size=least))
    held_out = learned_place.held_out
    guess_mm = guess_error(place_mm[held_out.presses])
    row_order = None
    if held_out.mean_mm > DOUBTFUL_SHARE * guess_mm:
        tell("looking for rows out of step")
        row_order = find_row_order(
            np.where(used_mask[:, None], readings.changes, 0.0), presses.place_mm, row_shift=labelled.row_shift
        )
    quantities = {
        name: _learn_quantity(name, values[used_mask], learned_place, tell)
        for name, unit in PRESS_QUANTITIES.items()
        if (values := getattr(presses, f"{name}_{unit}")) is not None
    }
    weak_findings = (
        words for name, quantity in quantities.items() for words in _warn_of_poor_estimate(name, quantity)
    )
    press_findings = (*name_far_from_labels(presses, np.flatnonzero(used_mask)[held_out.presses], held_out.found_mm),)
    if registration.trusted:
        press_findings += (*name_off_sheet(presses, registration, outline),)
    unused_electrodes = list_unused_electrodes(readings.distinct.pairs, labelled.sensor_type.electrodes.count)
    reading_findings = (
        *list_ignored_columns(presses),
        *unused_electrodes,
        *dead_readings.findings,
        *_warn_of_clipping(clipped_share),
        *press_findings,
    )
    sheet_findings = *reading_findings, *_describe_sheet(order, clipped_share, radius_stated=labelled.radius_stated)
    findings = (
        *([] if row_order is None else [row_order.words]),
        *sheet_findings,
        *learned_place.warnings,
        *weak_findings,
        *([_ORDERED_BY_PLACE] if labelled.follow_places() else []),
    )
    modelled = _model_place(replace(labelled, readings=readings), sheet, order, learned_place.model.mixture.quantiles)
    left_out = zip(used_mask.tolist(), dead_readings.left_out, strict=True)
    why_not = tuple("" if row else why or "no reading changes" for row, why in left_out)
    return PressesLearned(
        registration, findings, used_mask, why_not, learned_place, guess_mm, row_order, modelled, quantities
    )


def noise_size(noise: Array) -> float:
    """Return the root mean square of readings that noise (m,) alone exceeds in about one frame of a thousand."""
    variance = noise**2
    return float(np.sqrt(variance.mean() + _NOISE_DEVIATIONS * np.sqrt(2 * (variance**2).sum()) / len(noise)))


def _learn_place(
    sensor_type: SensorType,
    order: ElectrodeOrder,
    changes: Array,
    place_mm: Array,
    time_s: Array | None,
    missing: Mask,
    modelled: Modelled | None,
    tell: Tell,
) -> PlaceLearned:
    """Learn the place, starting from the registered pose if that is trusted."""
    registration, layout = order.registered.registration, sensor_type.electrodes
    centre = np.array(registration.shift_mm) if registration.trusted else None
    axes = None
    if centre is not None and isinstance(layout, ElectrodeLayout):
        onto_sheet = registration.scale * registration.on_sheet_mm(centre + np.eye(2)).T
        axes = ring_axes(layout) @ onto_sheet
    return learn_place(
        changes,
        place_mm,
        order.pairs,
        layout.count,
        centre_mm=centre,
        axes=axes,
        time_s=time_s,
        missing=missing,
        modelled=modelled,
        tell=tell,
    )


def _expect_changes(sheet: ModelledSheet, order: ElectrodeOrder, changes: Array, used: Mask) -> Modelled:
    """Return what the registered sheet lets expect of the used presses that are clear of edge and electrodes."""
    places = order.registered.places[used]

    def expect(presses: Indices) -> Array:
        expected = np.full((len(presses), len(order.pairs)), np.nan)
        clear_mask = sheet.clear(places[presses])
        if clear_mask.any():
            answers = answering_side(sheet, order.pairs, changes).answers
            loads = sheet.loads(places[presses[clear_mask]])
            expected[clear_mask] = order.registered.sign * loads.readings(order.pairs) * answers
        return expected

    return expect


def _model_place(
    labelled: LabelledPresses, sheet: ModelledSheet, order: ElectrodeOrder, quantiles: Array
) -> ModelledPlace:
    """Return the templates of the registered sheet, with the errors of the presses that it was registered to."""
    readings, registered, lattice = labelled.readings, order.registered, sheet.lattice
    answers = answering_side(sheet, order.pairs, readings.changes).answers
    noise = 0.0 if readings.noise is None else float(np.sqrt((readings.noise[answers] ** 2).mean()))
    step_mm = STEP * registered.registration.radius_mm
    templates = registered.sign * lattice.readings(order.pairs) * answers
    model = ModelledPlace(lattice.node, step_mm, templates, 1.0, 1.0, noise)
    found_mm = ModelledEstimator(model, registered.registration)(readings.changes).place_mm
    return with_variance(model, found_mm - labelled.presses.place_mm, quantiles)


def _learn_quantity(name: str, values: Array, learned: PlaceLearned, tell: Tell) -> LearnedQuantity:
    """Learn force or depth from its values (n,) at the presses; CalibrationError if they are all the same."""
    if not np.ptp(values):
        raise CalibrationError(f"every press that changes a reading has the same {name}: {values[0]:g}")
    tell(f"learning the {name}")
    found_presses = learned.found
    return learn_quantity(
        values[found_presses.presses],
        found_presses.strength,
        found_presses.place_mm,
        learned.model.centre_mm,
        visits=found_presses.visits,
        session=found_presses.session,
        drifts=found_presses.drifts,
    )


def _warn_of_poor_estimate(name: str, quantity: LearnedQuantity) -> Iterator[str]:
    """Yield a warning if a quantity is estimated hardly better than by its median."""
    guessed = float(np.abs(quantity.values - np.median(quantity.values)).mean())
    if quantity.error > _UNINFORMATIVE_SHARE * guessed:
        unit = PRESS_QUANTITIES[name]
        words = f"the readings hardly tell the {name}"
        if is_untold(quantity):
            yield f"{words}: every press is given the middle of all, which misses them by {guessed:.2g} {unit}"
        else:
            yield (
                f"{words}: presses left out are missed by {quantity.error:.2g} {unit}, where"
                f" the middle of all presses misses them by {guessed:.2g} {unit}"
            )


def _find_electrode_order(labelled: LabelledPresses, sheet: ModelledSheet) -> ElectrodeOrder:
    """Find the electrode order and register the sheet; the pose is not trusted if places seem to be in metres.

    RecordingError if the places do not determine the pose.
    """
    readings, presses = labelled.readings, labelled.presses
    try:
        order = find_electrode_order(
            sheet,
            readings.distinct.pairs,
            readings.changes,
            presses.place_mm,
            radius_stated=labelled.radius_stated,
        )
    except NumericsError as error:
        raise RecordingError(
            f"{presses.table.path}, columns x_mm and y_mm: {error.reason}", remedy=error.remedy
        ) from error
    unit_warning = _warn_of_metres(presses.place_mm)
    if not unit_warning:
        return order
    registration = replace(order.registered.registration, trusted=False, why=unit_warning)
    return replace(order, registered=replace(order.registered, registration=registration))


def _warn_of_clipping(clipped: float) -> Iterator[str]:
    """Yield a warning if a share of the readings is clipped."""
    if clipped:
        yield (
            f"{clipped:.1%} of the readings are clipped: they have the same largest or smallest value; lower the gain"
            " or press less hard"
        )


def _warn_of_metres(place_mm: Array) -> str:
    """Return a warning if places (n, 2) seem to be in metres; empty if they seem to be in millimetres."""
    extent_mm = float(np.linalg.norm(np.ptp(place_mm, axis=0)))
    if extent_mm >= _MIN_EXTENT_MM:
        return ""
    return (
        f"all presses lie within {extent_mm:.3g} mm: their places seem to be in metres; x_mm and y_mm are in"
        " millimetres"
    )


def _describe_sheet(order: ElectrodeOrder, clipped: float, *, radius_stated: bool) -> Sequence[str]:
    """Return findings in words on the electrodes' wiring, and on the pose and scale of the sheet."""
    registration = order.registered.registration
    if not registration.trusted:
        return (*order.registered.findings, f"{registration.why}; the place is learned from the presses alone")
    findings = [*order.registered.findings, *(f"check the wiring: {words}" for words in order.findings)]
    if registration.mirrored:
        findings.append(_MIRRORED)
    if radius_stated and abs(registration.scale - 1) > max(3 * registration.scale_stderr, _MAX_SCALE_ERROR):
        why = f"the radius of {registration.radius_mm:.4g} mm or the unit of the places may be wrong"
        if clipped:
            why = "clipped readings make places seem nearer to the middle"
        findings.append(
            f"places on the sheet are {registration.scale:.3g} times as far apart among the presses: {why}"
        )
    return findings
