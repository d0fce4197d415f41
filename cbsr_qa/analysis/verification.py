"""Verification of a fielded sensor's calibration with a few short loads."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cbsr_qa.analysis.defects.quality import subtract_trend
from cbsr_qa.analysis.run.loads import load_window
from cbsr_qa.calibration.fits.relaxation import relaxation_curve
from cbsr_qa.calibration.fits.steady_state import predict_steady
from cbsr_qa.calibration.force.shared_error import SharedError
from cbsr_qa.calibration.force.sheet_pose import AS_PLACED, SheetPose, sheet_pose_of
from cbsr_qa.calibration.force.template_matching import Matches
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.standards import ReferenceStandard, StandardRole, find_standard
from cbsr_qa.domain.readings.frames import SampleBlock
from cbsr_qa.domain.results.observation import LoadObservation, RunObservation
from cbsr_qa.domain.results.relaxation import FitStatus

#: Time before which force samples are of a head still coming to rest [s].
_SETTLED_S: Final = 1.0
_NO_RELAXATION: Final = (FitStatus.REJECTED, FitStatus.DRIFTING)


@dataclass(frozen=True, slots=True)
class VerifiedLoad:
    """Force of one load by the calibration and by the load cell.

    Parameters
    ----------
    measured_N : by the load cell, extrapolated to the hold of the calibration.
    estimated_N : by the calibration, from the hold so far.
    stderr_N : standard error of their difference.
    """

    load: LoadObservation
    measured_N: float
    estimated_N: float
    stderr_N: float


@dataclass(frozen=True, slots=True)
class Verification:
    """Change of a sensor since its calibration.

    Parameters
    ----------
    sensitivity, sensitivity_stderr : estimated over measured force, all loads combined; 1 if nothing changed.
    reference_change : change of the unloaded readings since the calibration, root mean square over that of the
        readings.
    noise_ratio : noise of a reading over that of the calibration.
    error : what standard errors include, in words.
    """

    loads: tuple[VerifiedLoad, ...]
    sensitivity: float
    sensitivity_stderr: float
    reference_change: float
    noise_ratio: float
    error: str


def verify_calibration(run: RunObservation, calibration: Calibration) -> Verification:
    """Compare a run's loads with a calibration of the same sensor.

    The sheet's current position is used. The run's own unloaded frames are the reference, so that drift of the
    unloaded sheet is reported but does not affect forces. Holds may be far shorter than the calibration's: their end
    values are predicted from the sensor's own relaxation, for readings and force alike.

    Raises
    ------
    CalibrationError
        If the calibration is another sensor's or of another geometry, a reading it needs is gone, or no load of the
        run was a single press, with its force, within the calibrated range.
    """
    _check(run, calibration)
    reader = _Reader(run, calibration)
    loads = tuple(verified for load in run.loads if (verified := reader.load(load)) is not None)
    if not loads:
        raise CalibrationError(
            "no load of the run was pressed alone, with its force recorded, where the calibration reaches"
        )
    shared_errors, words = compare_load_cells(calibration.issued.standards, run.standards)
    sensitivity, stderr = _sensitivity(loads, shared_errors)
    traced_loads = tuple(
        replace(
            load,
            stderr_N=float(np.hypot(load.stderr_N, _add_squares(shared_errors, np.array([load.measured_N]))[0])),
        )
        for load in loads
    )
    return Verification(traced_loads, sensitivity, stderr, reader.reference_change(), reader.noise_ratio(), words)


def compare_load_cells(
    calibrated: Sequence[ReferenceStandard], measured: Sequence[ReferenceStandard]
) -> tuple[tuple[SharedError, ...], str]:
    """Return the errors of load cells that remain between a calibration's forces and a run's, and what is included.

    If both state one certificate, the cell's error is in both forces and cancels. Otherwise two calibrations of load
    cells are compared, and the errors of both remain, as far as they are stated.

    Parameters
    ----------
    calibrated, measured : standards of the calibration, and of the run.
    """
    cells = {
        whose: find_standard(standards, StandardRole.LOAD_CELL)
        for whose, standards in (("calibration", calibrated), ("run", measured))
    }
    stated = {whose: cell for whose, cell in cells.items() if cell is not None}
    certificates = {(cell.laboratory, cell.certificate, cell.date) for cell in stated.values()}
    if len(stated) == len(cells) and len(certificates) == 1:
        (_, certificate, _) = certificates.pop()
        return (), f"scatter only; certificate {certificate} of the load cell is that of the calibration, it cancels"
    parts = ["scatter", *(f"load cell of the {whose} ({cell.words()})" for whose, cell in stated.items())]
    missing = " and of the ".join(whose for whose in cells if whose not in stated)
    words = f"{' and '.join(parts)}{'' if stated else ' only'}"
    shared_errors = tuple(SharedError((cell,)) for cell in stated.values())
    return shared_errors, f"{words}; load cell of the {missing} not stated" if missing else words


def _check(run: RunObservation, calibration: Calibration) -> None:
    issued, serial = calibration.issued, run.record.identity.sensor.serial
    if issued.sensor.serial != serial:
        raise CalibrationError(f"the calibration is for sensor {issued.sensor.serial}, the run for {serial}")
    if issued.reference.shape != run.reference.shape:
        raise CalibrationError(
            f"the calibration has frames of shape {issued.reference.shape}, the run {run.reference.shape}"
        )
    lost_mask = issued.reconstruction.problem.used & ~run.usable
    if lost_mask.any():
        raise CalibrationError(
            f"{int(lost_mask.sum())} readings that the calibration needs are no longer usable",
            remedy="see the report's contacts: repair the electrode, or calibrate the sensor again",
        )


class _Reader:
    def __init__(self, run: RunObservation, calibration: Calibration) -> None:
        self._run, self._calibration = run, calibration
        self._used = calibration.issued.reconstruction.problem.used
        current_A = run.unloaded.current_A
        self._per_A = calibration.issued.current_A / current_A if current_A else 1.0
        self.sheet_pose = self._sheet_pose()

    def _sheet_pose(self) -> SheetPose:
        rows, noise, places = [], [], []
        for load in self._run.loads:
            phase = self._run.record.phase(load.phase)
            if phase.frames is None or load.together > 1:
                continue
            steady_frames = load_window(phase, load.record, self._run.settings).steady
            rows.append(self._rows(steady_frames.voltages).mean(axis=0))
            noise.append(1 / len(steady_frames))
            places.append(load.place_mm)
        if not rows:
            return AS_PLACED
        return sheet_pose_of(np.array(places), self._calibration.filter.search(np.array(rows)), np.array(noise))

    def reference_change(self) -> float:
        calibrated = self._calibration.issued.reference[self._used]
        current = self._run.reference[self._used] * self._per_A
        return float(np.linalg.norm(current - calibrated) / np.linalg.norm(calibrated))

    def noise_ratio(self) -> float:
        """Noise of the unloaded frames about a straight line in time; rows have unit noise in the calibration."""
        rows, time_s = self._rows(self._run.unloaded.voltages), self._run.unloaded.time_s
        residuals = subtract_trend(rows, time_s)
        return float(np.sqrt((residuals**2).sum() / ((len(rows) - 2) * rows.shape[1]))) if len(rows) > 2 else 1.0

    def load(self, load: LoadObservation) -> VerifiedLoad | None:
        """Evaluate one load; None if it was not alone, has no force, or is out of range."""
        record, model = load.record, self._calibration.model
        phase = self._run.record.phase(load.phase)
        cell = phase.channel("force")
        place = self.sheet_pose.places_mm(np.array([load.place_mm]))[0]
        if load.together > 1 or cell is None or load.force_N is None or phase.frames is None:
            return None
        held_frames = phase.frames.select_interval(record.hold_start_s, record.release_start_s)
        frames_before = load_window(phase, record, self._run.settings).before
        matches = self._calibration.filter.match_at(self._rows(held_frames.voltages), place)
        if not np.isfinite(matches.strength).all():
            return None
        strength_before = self._calibration.filter.match_at(self._rows(frames_before.voltages), place).strength
        base = model.residue_share * float(strength_before.mean()) if len(strength_before) else 0.0
        strength, stderr = self._estimate_hold_strength(held_frames.time_s - record.hold_start_s, matches, base, load)
        match = Matches(place[None], np.array([strength]), np.zeros((1, 3, 3)), np.zeros(1), np.zeros(1))
        match.covariance[0, 0, 0] = stderr**2 + (model.residue_stderr * base / model.residue_share) ** 2
        estimated, error = self._calibration.inverse.force(match)
        if not np.isfinite(estimated[0]):
            return None
        measured = self._estimate_hold_force_N(
            cell.select_interval(record.hold_start_s + _SETTLED_S, record.release_start_s), load
        )
        return VerifiedLoad(load, measured, float(estimated[0]), float(error[0]))

    def _rows(self, voltages: Array) -> Array:
        return (voltages - self._run.reference)[:, self._used] @ self._calibration.model.merging.T * self._per_A

    def _estimate_hold_strength(
        self, held_s: Array, matches: Matches, base: float, load: LoadObservation
    ) -> tuple[float, float]:
        """Strength at the hold of the calibration and its standard error."""
        model, noise = self._calibration.model, np.sqrt(matches.covariance[:, 0, 0])
        if model.loading is None:
            late = held_s > held_s[-1] - (held_s[-1] - held_s[0]) / 4
            return float(matches.strength[late].mean()) - base, float(noise[0] / np.sqrt(late.sum()))
        ramp_s = max(load.record.unloaded_s - load.record.release_start_s, 0.0)
        prediction = predict_steady(
            held_s, matches.strength - base, noise, model.loading, ramp_s=ramp_s, at_s=model.steady_s
        )
        return float(prediction.values[0]), float(prediction.stderr[0])

    def _estimate_hold_force_N(self, samples: SampleBlock, load: LoadObservation) -> float:
        """Force at the hold of the calibration, from the relaxation of stress there."""
        held_s = samples.time_s - load.record.hold_start_s
        stresses = [
            relaxation.fit
            for relaxation in self._calibration.issued.relaxations
            if relaxation.signal == "stress" and relaxation.loading
        ]
        shapes = [fit for fit in stresses if fit.status not in _NO_RELAXATION and fit.offset > 0]
        if not shapes or not len(samples):
            return float(load.force_N or 0.0)
        steady_s = self._calibration.model.steady_s
        ratios = [relaxation_curve(fit, np.array([steady_s]))[0] / relaxation_curve(fit, held_s) for fit in shapes]
        return float(np.mean(samples.values * np.median(ratios, axis=0)))


def _sensitivity(loads: tuple[VerifiedLoad, ...], shared_errors: Sequence[SharedError]) -> tuple[float, float]:
    """Slope through zero of estimated over measured force, and its standard error.

    That of scatter is at least the scatter of the loads; an error that all loads share moves the slope as a whole.
    """
    measured = np.array([load.measured_N for load in loads])
    estimated = np.array([load.estimated_N for load in loads])
    weight = 1 / np.array([load.stderr_N for load in loads]) ** 2
    information = float(weight @ measured**2)
    slope = float(weight @ (measured * estimated)) / information
    spare = len(loads) - 1
    misfit = float(weight @ (estimated - slope * measured) ** 2) / spare if spare else 1.0
    shared = [float(weight @ (measured * error.stderr_N(measured))) / information for error in shared_errors]
    return slope, float(np.sqrt(max(misfit, 1.0) / information + np.sum(np.square(shared))))


def _add_squares(shared_errors: Sequence[SharedError], force_N: Array) -> Array:
    """Standard error (n,) that independent shared errors give forces (n,) together [N]."""
    variance = sum((error.stderr_N(force_N) ** 2 for error in shared_errors), np.zeros(len(force_N)))
    return np.sqrt(variance)
