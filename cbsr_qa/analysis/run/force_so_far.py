"""What the presses of a run so far say about force: the error that it would have, and after one more press."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from cbsr_qa.analysis.run.force import RunForce, learn_without_tests
from cbsr_qa.calibration.force.expected_error import (
    ForceError,
    LoadErrors,
    LoadsThatMatter,
    expect_after_presses,
    expect_force_error,
)
from cbsr_qa.calibration.force.interpolation import interpolate
from cbsr_qa.calibration.force.learning import LearnedForce
from cbsr_qa.calibration.sheet.learned_map import LearnedMap
from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.observation import RunObservation


@dataclass(frozen=True, slots=True, eq=False)
class ForceSoFar:
    """The map learned so far, and the errors of force beside it.

    Parameters
    ----------
    force : what was learned.
    places_mm : (t, 2) places of the loads that matter, on the sheet.
    variance : variance of the logarithm of the response that one more press would measure, by noise.
    """

    force: RunForce
    response: LearnedMap
    places_mm: Array
    errors: LoadErrors
    variance: float

    @classmethod
    def learn(cls, run: RunObservation, loads: LoadsThatMatter) -> Self:
        """Learn force from the run's loads that calibrate.

        Raises
        ------
        CbsrError
            If nothing can be learned from them, with the reason.
        """
        force = learn_without_tests(run)
        learned = force.learned
        assert learned is not None
        used = np.isfinite(learned.ratio)
        relative = learned.ratio_stderr[used] / learned.ratio[used]
        strains = np.array([load.record.load.strain for load in force.used])
        per_strain_N = float(np.median([load.force_N for load in force.used if load.force_N] / strains))
        places_mm = force.sheet_pose.places_mm(loads.places_mm())
        head = run.record.indenter
        errors = LoadErrors(
            lever_N=loads.lever_N(per_strain_N, learned.line, head),
            noise_N=_noise_N(learned, places_mm, run.settings.steady_frames, head),
            shared=_estimate_shared_error(learned, relative, used),
        )
        return cls(force, learned.response, places_mm, errors, float(np.median(relative**2)))

    def error(self, confidence: float) -> ForceError:
        """Return the expected error of force, with its upper bound of a confidence."""
        return expect_force_error(self.response, self.places_mm, self.errors, confidence)

    def expect_after_presses_N(self, candidates_mm: Array) -> Array:
        """Return the expected error (n,) after one more press at each candidate (n, 2) of the station [N]."""
        at_mm = self.force.sheet_pose.places_mm(candidates_mm)
        return expect_after_presses(self.response, at_mm, self.places_mm, self.errors, self.variance)


def _noise_N(learned: LearnedForce, places_mm: Array, frames: int, head: Indenter) -> float:
    """Error of force by the noise of the mean of some frames, root mean square over places (t, 2) [N].

    A strength's error by noise is e^(−log size) for one frame; the force's is A/α of it, over the response.
    """
    model = learned.model
    strength = np.exp(-interpolate(model, model.log_size, places_mm)) / np.sqrt(frames)
    response = np.exp(interpolate(model, model.log_response, places_mm))
    stress_kPa = strength / response / abs(learned.line.slope.value)
    return float(np.sqrt(np.mean(stress_kPa**2)) * head.area_mm2 * 1e-3)


def _estimate_shared_error(learned: LearnedForce, relative: Array, used: Mask) -> float:
    """Relative error that all forces share: none without predicted holds.

    That of the surest predicted hold is nearly all the kernel's, and each hold has the same.
    """
    predicted = np.array(learned.predicted, dtype=np.bool_)[used]
    return float(relative[predicted].min()) if predicted.any() else 0.0
