"""Place as the loads that calibrate teach it, beside the place by the model of the sheet."""

import numpy as np

from cbsr_qa.analysis.run.force import force_loads, run_force
from cbsr_qa.analysis.run.place_found import PlaceErrors, RunPlace
from cbsr_qa.calibration.force.learning import CalibrationLoads
from cbsr_qa.calibration.force.template_matching import TemplateFilter
from cbsr_qa.calibration.place.features import ring_axes
from cbsr_qa.calibration.place.held_out import mean_by_place, visits_of
from cbsr_qa.calibration.place.learning import FEWEST_PRESSES, PlaceLearned, learn_place
from cbsr_qa.calibration.runtime.pressed_place import PressedPlace, row_readings
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.sensor.electrodes import ElectrodeLayout


def learn_and_compare(run: RunObservation) -> RunPlace:
    """Learn place from the loads that calibrate, and compare it with the model of the sheet.

    Raises
    ------
    CbsrError
        If there is no force model, or too few places were pressed.
    """
    force = run_force(run)
    if force.learned is None:
        raise CalibrationError(f"there is no force model, whose templates locate otherwise: {force.why}")
    loads, data = force_loads(run)
    calibrating = np.array([load.phase in run.settings.calibrate_phases for load in loads])
    used_mask = calibrating.copy()
    used_mask[calibrating] = [not refusal for refusal in force.learned.refused]
    places = len(np.unique(data.place_mm[used_mask], axis=0))
    if places < FEWEST_PRESSES:
        raise CalibrationError(f"the loads that calibrate are at {places} places; {FEWEST_PRESSES} are needed")
    merging, finder = force.learned.model.merging, TemplateFilter(force.learned.model)
    rows, _ = data.subtract_residues()
    time_s = np.array([load.record.hold_start_s for load in loads])
    learned = _learn_from_readings(
        run, row_readings(rows[used_mask], merging), data.place_mm[used_mask], time_s[used_mask]
    )
    modelled = finder.search(rows)
    presses = np.flatnonzero(used_mask)[learned.held_out.presses]
    left_out_errors = _place_errors(data.place_mm[presses], learned.held_out.found_mm, modelled.place_mm[presses])
    spread = {phase.name for phase in run.record.phases if phase.role in (Role.GRID, Role.RANDOM)}
    others_mask = ~calibrating & np.array([load.phase in spread for load in loads])
    other_errors = (
        _measure_modelled(data, others_mask, finder, PressedPlace(learned.model, merging))
        if others_mask.any()
        else None
    )
    return RunPlace(learned, places=places, left_out=left_out_errors, others=other_errors)


def _measure_modelled(
    data: CalibrationLoads, which: Mask, finder: TemplateFilter, pressed: PressedPlace
) -> PlaceErrors:
    """Errors of loads located as the calibration in use locates them."""
    rows = data.subtract_residues()[0][which]
    modelled = finder.search(rows)
    matches = pressed(rows, modelled, modelled, finder)
    return _place_errors(data.place_mm[which], matches.place_mm, modelled.place_mm)


def _learn_from_readings(run: RunObservation, readings: Array, place_mm: Array, time_s: Array) -> PlaceLearned:
    """Learn from readings (n, r) at places (n, 2) on the sheet, whose axes and centre are known."""
    layout = run.record.sensor_type.electrodes
    return learn_place(
        readings,
        place_mm,
        _row_pairs(run),
        layout.count,
        centre_mm=np.zeros(2),
        axes=ring_axes(layout) if isinstance(layout, ElectrodeLayout) else None,
        time_s=time_s,
    )


def _row_pairs(run: RunObservation) -> Indices:
    """Pairs (r, 4) of the rows, source, sink, plus and minus: of the first reading of each group of equal ones."""
    pattern, used_mask = run.record.sensor_type.pattern, run.usable
    groups, signs = (indices[used_mask] for indices in pattern.reading_groups())
    _, first_of_group = np.unique(groups, return_index=True)
    drive, measure = (indices[first_of_group] for indices in np.nonzero(used_mask))
    pairs = [
        (*pattern.drive[d], *(pattern.measure[m] if sign > 0 else pattern.measure[m][::-1]))
        for d, m, sign in zip(drive, measure, signs[first_of_group], strict=True)
    ]
    return np.array(pairs, dtype=np.int64)


def _place_errors(pressed_mm: Array, learned_mm: Array, modelled_mm: Array) -> PlaceErrors:
    """Errors of places (n, 2) found by both estimates."""
    learned, modelled = (np.linalg.norm(found_mm - pressed_mm, axis=1) for found_mm in (learned_mm, modelled_mm))
    gain, stderr = mean_by_place(modelled - learned, visits_of(pressed_mm))
    return PlaceErrors(len(pressed_mm), float(learned.mean()), float(modelled.mean()), gain, stderr)
