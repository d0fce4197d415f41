"""The force model of a run's sensor, tested on held-out loads."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.run.estimates import model_scale, reading_variance
from cbsr_qa.analysis.run.force_kernels import StrengthTraces, force_kernels, key_of, steady_s
from cbsr_qa.analysis.run.loads import window_of
from cbsr_qa.calibration.fits.common_relaxation import TimedValues
from cbsr_qa.calibration.force.inverse import ForceInverse, map_tables
from cbsr_qa.calibration.force.learning import CalibrationLoads, LearnedForce, MapLearner, learn_force
from cbsr_qa.calibration.force.sheet_pose import AS_PLACED, SheetPose, sheet_pose_of
from cbsr_qa.calibration.force.template_matching import Matches, TemplateFilter, add_scatter
from cbsr_qa.calibration.force.templates import TemplateBank, make_even_model, template_bank
from cbsr_qa.calibration.sheet.response_map import learn_response
from cbsr_qa.domain.errors import CbsrError, NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.calibration import ForceModel
from cbsr_qa.domain.results.observation import LoadObservation, RunObservation
from cbsr_qa.eit.estimate.readings import load_model, merge_reciprocal

if TYPE_CHECKING:
    from cbsr_qa.analysis.run.compensation import BorrowedKernels

#: Names of the tests of a load.
HELD_OUT: Final = "held out"
TRIAL_LEFT_OUT: Final = "trial left out"
#: Number of standard errors within which a load confirms a force model.
_BORNE_OUT: Final = 3.0


@dataclass(frozen=True, slots=True)
class ForceTest:
    """Estimated force of one held-out load, and the load cell's.

    Parameters
    ----------
    load : load of the run; for a predicted hold with the force at the predicted time.
    how : ``"held out"`` (a phase that does not calibrate) or ``"trial left out"``.
    measured_N : by the load cell, predicted like the hold.
    known_N, known_stderr_N : with the place of the head given.
    found_N, found_stderr_N : with the place estimated; None if no load was detected.
    place_error_mm : error of that place [mm], or None.
    global_N : with the place given and one response for the whole sheet, the paper's way.
    """

    load: LoadObservation
    how: str
    measured_N: float
    known_N: float
    known_stderr_N: float
    found_N: float | None
    found_stderr_N: float | None
    place_error_mm: float | None
    global_N: float


@dataclass(frozen=True, slots=True, eq=False)
class RunForce:
    """Force model of a run with its tests.

    Parameters
    ----------
    learned : None if nothing could be learned, for the reason ``why``.
    used : loads it was learned from, in order of ``learned.refused``; for predicted holds with the force at the
        predicted time.
    tests : tests of unused loads: held out, or of a left-out trial at places of the other trials.
    sheet_pose : position of the sheet; places of the map and of all loads are relative to it.
    """

    learned: LearnedForce | None
    used: tuple[LoadObservation, ...]
    tests: tuple[ForceTest, ...]
    why: str = ""
    sheet_pose: SheetPose = AS_PLACED

    def list_confirmed_loads(self) -> tuple[LoadObservation, ...]:
        """Held-out loads whose force agrees within three standard errors, the place known."""
        held_out = [test for test in self.tests if test.how == HELD_OUT]
        return tuple(t.load for t in held_out if abs(t.known_N - t.measured_N) <= _BORNE_OUT * t.known_stderr_N)


def run_force(run: RunObservation) -> RunForce:
    """Return a run's force model, learned from the phases that calibrate and tested on all other loads.

    Loads of phases that do not calibrate are held out. If places were pressed in several trials, each trial is also
    left out in turn, and its loads at places of the others are tested. The result is cached with the run.

    Returns
    -------
    RunForce, with the reason if there is no model.
    """
    return run.derive(_learn_and_test)


def _learn_and_test(run: RunObservation) -> RunForce:
    try:
        return run.derive(_RunForce).result()
    except CbsrError as error:
        return RunForce(None, (), (), error.reason)


def learn_without_tests(run: RunObservation) -> RunForce:
    """Learn the force model from all loads of phases that calibrate, without a test.

    Raise CbsrError if nothing can be learned, with the reason.
    """
    loads = run.derive(_RunForce)
    calibrating = np.array([load.phase in run.settings.calibrate_phases for load in loads.loads])
    calibrating_loads = tuple(compress(loads.loads, calibrating))
    learned = loads.learn(calibrating)
    if loads.at_s is not None:
        learned = replace(learned, model=replace(learned.model, steady_s=loads.at_s))
    return RunForce(learned, calibrating_loads, (), sheet_pose=loads.sheet_pose)


def force_tests(run: RunObservation, learned: LearnedForce) -> tuple[ForceTest, ...]:
    """Test a model, learned elsewhere, on every load of a run, without predicting holds.

    Raise CbsrError if the run has no load with a force, or its noise cannot be estimated.
    """
    loads = _RunForce(replace(run, settings=replace(run.settings, transients="averaged")))
    return tuple(loads.tests(learned, np.ones(len(loads.loads), dtype=np.bool_), HELD_OUT))


def force_loads(run: RunObservation) -> tuple[tuple[LoadObservation, ...], CalibrationLoads]:
    """Loads pressed alone with their force recorded, and what force is learned from, at their places on the sheet.

    Raise CbsrError if the run has no such load, or its noise cannot be estimated.
    """
    of_run = run.derive(_RunForce)
    return of_run.loads, of_run.data


def strength_traces(run: RunObservation) -> StrengthTraces:
    """Strengths over time at the places of a run's loads.

    Raise CbsrError if the run has no load with a force, or its noise cannot be estimated.
    """
    return run.derive(_RunForce).strengths()


def hold_traces(run: RunObservation, loads: Sequence[LoadObservation]) -> list[TimedValues]:
    """Strengths under holds at the places of loads, from the start of each [s], without residues of earlier ones.

    Raise CbsrError if the run has no load with a force, or its noise cannot be estimated.
    """
    strengths = strength_traces(run)
    return [strengths.change(load) for load in loads]


def _choose_prior(run: RunObservation) -> tuple[MapLearner, "BorrowedKernels | None"]:
    """Return what learns the map, from the run's loads alone or with its batch, and the batch's kernels."""
    if run.settings.prior == "none":
        return learn_response, None
    from cbsr_qa.analysis.run.batch_prior import choose_batch_prior  # loads what few recipes need

    return choose_batch_prior(run.settings)


class _RunForce:
    """One run's loads with the data for comparison."""

    def __init__(self, run: RunObservation) -> None:
        sensor_type = run.record.sensor_type
        model = load_model(sensor_type)
        scale = model_scale(model, run.reference, run.usable)
        readings = merge_reciprocal(
            sensor_type.pattern, run.usable, reading_variance(run.unloaded, run.usable) / scale**2
        )
        self.run = run
        self.head = run.record.indenter
        self.line = run.record.material.against_stress
        self.merging = readings.merging / scale
        self.bank: TemplateBank = template_bank(model, readings, self.head)
        single_loads = [load for load in run.loads if load.force_N is not None and load.together == 1]
        self.loads = tuple(single_loads)
        self.data, self.sheet_pose = self._locate_on_sheet(self._data())
        self.learn_map, self.borrowed = _choose_prior(run)
        self.at_s: float | None = None
        self.predicted = np.zeros(len(single_loads), dtype=np.bool_)
        if run.settings.transients == "predicted":
            self._compensate()

    def _compensate(self) -> None:
        """Extend short holds to the end of the longest ones; their loads get the force at that time."""
        from cbsr_qa.analysis.run.compensation import compensate_loads  # loads what few recipes need

        done = compensate_loads(self.run, self.loads, self.data, self.strengths(), self.borrowed)
        self.data, self.at_s, self.predicted = done.data, done.at_s, done.predicted
        self.loads = tuple(
            replace(load, force_N=float(force), force_stderr_N=float(stderr)) if predicted else load
            for load, force, stderr, predicted in zip(
                self.loads, self.data.force_N, self.data.force_stderr_N, self.predicted, strict=True
            )
        )

    def _data(self) -> CalibrationLoads:
        if not self.loads:
            raise NumericsError(
                "no load was pressed alone with its force recorded (several loads were held at once, or no load cell)"
            )
        windows = [window_of(self.run, load) for load in self.loads]
        steady = [self._rows(window.steady.voltages) for window in windows]
        rows_before = [self._rows(window.before.voltages) for window in windows]
        zero_row = np.zeros(self.merging.shape[0])
        return CalibrationLoads(
            place_mm=np.array([load.place_mm for load in self.loads]),
            rows=np.array([rows.mean(axis=0) for rows in steady]),
            frames=np.array([len(rows) for rows in steady]),
            before=np.array([rows.mean(axis=0) if len(rows) else zero_row for rows in rows_before]),
            frames_before=np.array([len(rows) for rows in rows_before]),
            force_N=np.array([load.force_N for load in self.loads], dtype=np.float64),
            force_stderr_N=np.array([load.force_stderr_N or 0.0 for load in self.loads]),
        )

    def strengths(self) -> StrengthTraces:
        places = dict(zip(map(key_of, self.loads), self.data.place_mm, strict=True))
        return StrengthTraces(
            self.run, places, self.merging, TemplateFilter(make_even_model(self.bank, self.merging))
        )

    def _locate_on_sheet(self, data: CalibrationLoads) -> tuple[CalibrationLoads, SheetPose]:
        """Loads at their places on the sheet, which may be misplaced."""
        rows, noise = data.subtract_residues()
        pose = sheet_pose_of(
            data.place_mm, TemplateFilter(make_even_model(self.bank, self.merging)).search(rows), noise
        )
        return replace(data, place_mm=pose.places_mm(data.place_mm)), pose

    def _rows(self, voltages: Array) -> Array:
        return (voltages - self.run.reference)[:, self.run.usable] @ self.merging.T

    def result(self) -> RunForce:
        calibrating = np.array([load.phase in self.run.settings.calibrate_phases for load in self.loads])
        learned = self.add_kernels(self.learn(calibrating), calibrating)
        tests = self.tests(learned, ~calibrating, HELD_OUT)
        trials = np.array([load.record.load.trial for load in self.loads])
        for trial in sorted(set(trials[calibrating].tolist())):
            left_out_mask = calibrating & (trials == trial)
            others_mask = calibrating & ~left_out_mask
            # Whether each load's place was pressed by others; elsewhere repeatability is not tested.
            places = {tuple(place) for place in self.data.place_mm[others_mask].tolist()}
            pressed_by_others = np.array(
                [tuple(place) in places for place in self.data.place_mm.tolist()], dtype=np.bool_
            )
            again_mask = left_out_mask & pressed_by_others
            if again_mask.any():
                tests += self.tests(self.learn(others_mask), again_mask, TRIAL_LEFT_OUT)
        calibrating_loads = tuple(compress(self.loads, calibrating))
        return RunForce(learned, calibrating_loads, tuple(tests), sheet_pose=self.sheet_pose)

    def add_kernels(self, learned: LearnedForce, which: NDArray[np.bool_]) -> LearnedForce:
        """Add the time of the hold at which loads were evaluated, and their kernels."""
        loads = list(compress(self.loads, which))
        filter_ = TemplateFilter(learned.model)
        loading, unloading = force_kernels(self.run, loads, self.data.place_mm[which], self.merging, filter_)
        if self.borrowed is not None and self.predicted[which].all():
            loading, unloading = self.borrowed.strength, self.borrowed.unloading
        held_to_s = float(np.mean([steady_s(self.run, load) for load in loads])) if self.at_s is None else self.at_s
        model = replace(learned.model, steady_s=held_to_s, loading=loading, unloading=unloading)
        return replace(learned, model=model)

    def learn(self, which: NDArray[np.bool_]) -> LearnedForce:
        learned = learn_force(
            self.bank,
            self.merging,
            self.data.select(which),
            self.line,
            self.head,
            radius_mm=self.run.record.sensor_type.radius_mm,
            learn_map=self.learn_map,
        )
        return replace(learned, predicted=tuple(self.predicted[which].tolist()))

    def tests(self, learned: LearnedForce, which: NDArray[np.bool_], how: str) -> list[ForceTest]:
        """Test a model on some loads; those whose head does not fit the map are excluded."""
        if not which.any():
            return []
        loads = list(compress(self.loads, which))
        data = self.data.select(which)
        filter_ = TemplateFilter(learned.model)
        inverse = ForceInverse(learned.model, learned.line, self.head.area_mm2, map_tables(learned.model))
        everywhere = _global(learned)
        flat_inverse = ForceInverse(everywhere, learned.line, self.head.area_mm2, map_tables(everywhere))
        rows, noise = data.subtract_residues()
        strength_left = filter_.match_at(data.before, data.place_mm).strength
        matches_at_places = _noisy(
            filter_.match_at(rows, data.place_mm), noise, strength_left * learned.model.residue_stderr
        )
        matches = _noisy(filter_.search(rows), noise, strength_left * learned.model.residue_stderr)
        matches = add_scatter(matches, filter_.size_slope(matches.place_mm), learned.model.place_scatter_mm)
        known_N, known_stderr_N = inverse.force(matches_at_places)
        flat_N, _ = flat_inverse.force(matches_at_places)
        found_N, found_stderr_N = inverse.force(matches)
        detected = np.sqrt(matches.gain / noise) >= learned.model.threshold
        distance_mm = np.hypot(*(matches.place_mm - data.place_mm).T)
        return [
            ForceTest(
                load=loads[k],
                how=how,
                measured_N=float(data.force_N[k]),
                known_N=float(known_N[k]),
                known_stderr_N=float(np.hypot(known_stderr_N[k], data.force_stderr_N[k])),
                found_N=float(found_N[k]) if detected[k] and np.isfinite(found_N[k]) else None,
                found_stderr_N=float(found_stderr_N[k]) if detected[k] and np.isfinite(found_N[k]) else None,
                place_error_mm=float(distance_mm[k]) if detected[k] else None,
                global_N=float(flat_N[k]),
            )
            for k in range(len(loads))
            if np.isfinite(known_N[k])
        ]


def _noisy(matches: Matches, noise: Array, residue: Array) -> Matches:
    """Matches of rows without unit noise, with possible residues of earlier loads in the strength."""
    covariance = matches.covariance * noise[:, None, None]
    covariance[:, 0, 0] += residue**2
    return replace(matches, covariance=covariance)


def _global(learned: LearnedForce) -> ForceModel:
    """The model with one response for the whole sheet: the mean of the loads' (the paper's ρ̄₀)."""
    ratio, error = learned.ratio, learned.ratio_stderr
    finite_mask = np.isfinite(ratio)
    mean = float(np.mean(ratio[finite_mask]))
    spread = float(np.std(ratio[finite_mask]) / mean)
    count = len(learned.model.log_response)
    return replace(
        learned.model,
        log_response=np.full(count, np.log(mean)),
        log_response_stderr=np.full(count, max(spread, float(np.mean(error[finite_mask])))),
    )
