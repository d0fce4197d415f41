"""Place learned from a run's own presses, and whether that pays: both estimates of the same presses, left out.

Places are learned as from labelled presses (:mod:`cbsr_qa.calibration.place`), from the loads that calibrate, where
the station pressed. The model of the sheet has learned nothing from them but the sheet's pose.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.analysis.run.force import RunForce, force_loads, run_force
from cbsr_qa.calibration.force.learning import CalibrationLoads
from cbsr_qa.calibration.force.template_matching import TemplateFilter
from cbsr_qa.calibration.place.features import ring_axes
from cbsr_qa.calibration.place.held_out import mean_by_place, visits_of
from cbsr_qa.calibration.place.learning import FEWEST_PRESSES, PlaceLearned, learn_place
from cbsr_qa.calibration.runtime.pressed_place import PressedPlace, row_readings
from cbsr_qa.domain.errors import CalibrationError, CbsrError
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.results.learned_place import PlaceOfRun
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.sensor.electrodes import ElectrodeLayout

#: Number of its standard errors beyond which a difference of means counts.
_CLEAR: Final = 2.0


@dataclass(frozen=True, slots=True)
class PlaceErrors:
    """Mean distance between found and pressed places of the same presses, by both estimates.

    Parameters
    ----------
    presses : number of presses.
    learned_mm, modelled_mm : errors of the place as learned without them, and of the place by the model of the sheet
        [mm].
    gain_mm, gain_stderr_mm : mean difference by which the learned place is nearer [mm], and its standard error;
        presses at one place count once for its standard error.
    """

    presses: int
    learned_mm: float
    modelled_mm: float
    gain_mm: float
    gain_stderr_mm: float

    @classmethod
    def from_places(cls, pressed_mm: Array, learned_mm: Array, modelled_mm: Array) -> "PlaceErrors":
        """Errors of places (n, 2) found by both estimates."""
        learned, modelled = (np.linalg.norm(found_mm - pressed_mm, axis=1) for found_mm in (learned_mm, modelled_mm))
        gain, stderr = mean_by_place(modelled - learned, visits_of(pressed_mm))
        return cls(len(pressed_mm), float(learned.mean()), float(modelled.mean()), gain, stderr)


@dataclass(frozen=True, slots=True, eq=False)
class RunPlace:
    """Place as learned from a run's presses.

    Parameters
    ----------
    learned : None if nothing was, for the reason ``why``.
    places : number of different places it was learned from.
    left_out : errors of the presses it was learned from, each located without those at its place.
    others : errors of loads all over the sheet that do not calibrate; None without any. They decide nothing.
    """

    learned: PlaceLearned | None
    why: str = ""
    places: int = 0
    left_out: PlaceErrors | None = None
    others: PlaceErrors | None = None

    @property
    def pays(self) -> bool:
        """Whether it is nearer than the model of the sheet by more than two standard errors, on presses left out."""
        errors = self.left_out
        return errors is not None and errors.gain_mm > _CLEAR * errors.gain_stderr_mm

    @property
    def used(self) -> PlaceOfRun | None:
        """Learned place that a calibration keeps; None unless it pays."""
        if self.learned is None or self.left_out is None or not self.pays:
            return None
        errors = self.left_out
        return PlaceOfRun(
            self.learned.model, errors.presses, errors.learned_mm, errors.modelled_mm, errors.gain_stderr_mm
        )

    @property
    def words(self) -> str:
        """The result and its reason in one sentence."""
        if self.left_out is None:
            return f"Place not learned: {self.why}"
        cv, others = self.left_out, self.others
        at = "" if self.places == cv.presses else f" at {self.places} places"
        sentence = (
            f"Place learned from {cv.presses} presses{at}: {cv.learned_mm:.2g} mm on presses left out, the model of"
            f" the sheet {cv.modelled_mm:.2g} mm (difference {cv.gain_mm:+.2g} ± {cv.gain_stderr_mm:.1g} mm)"
        ).replace("-", "−")
        if others is not None:
            sentence += f"; {others.learned_mm:.2g} and {others.modelled_mm:.2g} mm on {others.presses} other loads"
        if self.pays:
            return f"{sentence}: clearly nearer, so a calibration uses it"
        better = cv.gain_mm < -_CLEAR * cv.gain_stderr_mm
        return f"{sentence}: not used, the model is {'better' if better else 'as good'}"


def run_place(run: RunObservation) -> RunPlace:
    """Return what the loads that calibrate teach about place, if the recipe asks; it is cached with the run."""
    return run.derive(_run_place)


def _run_place(run: RunObservation) -> RunPlace:
    if not run.settings.learn_place:
        return RunPlace(None, "the recipe does not ask for it")
    force = run_force(run)
    try:
        return _learn_and_compare(run, force)
    except CbsrError as error:
        return RunPlace(None, error.reason)


def _learn_and_compare(run: RunObservation, force: RunForce) -> RunPlace:
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
    left_out_errors = PlaceErrors.from_places(
        data.place_mm[presses], learned.held_out.found_mm, modelled.place_mm[presses]
    )
    spread = {phase.name for phase in run.record.phases if phase.role in (Role.GRID, Role.RANDOM)}
    others_mask = ~calibrating & np.array([load.phase in spread for load in loads])
    other_errors = (
        _others(data, others_mask, finder, PressedPlace(learned.model, merging)) if others_mask.any() else None
    )
    return RunPlace(learned, places=places, left_out=left_out_errors, others=other_errors)


def _others(data: CalibrationLoads, which: Mask, finder: TemplateFilter, pressed: PressedPlace) -> PlaceErrors:
    """Errors of loads located as the calibration in use locates them."""
    rows = data.subtract_residues()[0][which]
    modelled = finder.search(rows)
    matches = pressed(rows, modelled, modelled, finder)
    return PlaceErrors.from_places(data.place_mm[which], matches.place_mm, modelled.place_mm)


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
