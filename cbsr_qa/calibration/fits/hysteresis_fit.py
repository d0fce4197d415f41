"""Hysteresis of the output against stress, from strains reached from below and from above.

ISA-37.1: the largest difference in output, at any value of the measurand within its range, when that value is
approached first with increasing and then with decreasing measurand; within one calibration cycle, in percent of
full-scale output. Here the measurand is the stress under the head, the calibration cycle a loop up and down through
some strains, and the full-scale output that at its deepest strain.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.calibration.fits.estimates import Estimate
from cbsr_qa.calibration.fits.superposition import Levels, estimate_levels, levels_read
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, finite_numbers
from cbsr_qa.domain.results.observation import LoopObservation

#: Holds of a loop are equally long within this share, as frames are whole.
_MAX_HOLD_DIFFERENCE: Final = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class LoopCurve:
    """Response of a place on the way up and down, mean over its cycles.

    Parameters
    ----------
    location, x_mm, y_mm : name and coordinates of the place.
    cycles, hold_s : number of loops, and time each strain was held.
    peak : index of the deepest strain; up to it the strain rises, after it it falls.
    strain, stress_kPa, output : (n,) float64 in order of holding; the output relative to that at the peak.
    difference, stderr : (n − 1 − peak,) output at the falling strains less that of the way up at the same stress,
        and one standard error.
    """

    location: str
    x_mm: float
    y_mm: float
    cycles: int
    hold_s: float
    peak: int
    strain: Array
    stress_kPa: Array
    output: Array
    difference: Array
    stderr: Array


@dataclass(frozen=True, slots=True)
class Hysteresis:
    """The greatest difference between the branches.

    Parameters
    ----------
    estimate : size of the difference in shares of the span, with the error of the difference there.
    strain : strain of that difference, on the way down.
    higher : True if the output there is higher on the way down than on the way up.
    """

    estimate: Estimate
    strain: float
    higher: bool


def loop_curve(loop: LoopObservation, *, relaxed: bool, last_s: float) -> LoopCurve:
    """Compute one place's branches.

    The output of the way up is interpolated linearly at the stresses of the way down, including the unloaded sheet;
    equal strains have nearly equal stresses, so little is interpolated. The error is the larger of that from noise
    and fit and that from the cycles' scatter.

    Parameters
    ----------
    relaxed : True to extrapolate to relaxed levels; False for levels at the end of each hold.
    last_s : time at the end of each hold that is averaged for the latter.

    Raises
    ------
    NumericsError
        If nothing was sensed, no force was recorded, the press did not go up and then down through strains held
        equally long, or relaxation cannot be removed.
    """
    strain, peak, hold_s = _check_cycles(loop)
    assert loop.stress is not None
    records = loop.records
    if relaxed:
        output = estimate_levels(records, loop.output, rests=True)
        stress = estimate_levels(records, loop.stress, rests=False)
    else:
        output = levels_read(records, loop.output, last_s, loop.noise)
        stress = levels_read(records, loop.stress, last_s)
    differences = _differences(output.values, stress.values, peak)
    propagated_stderr = _propagate_errors(output, stress, peak, differences.mean(axis=0))
    count = len(records)
    cycle_stderr = differences.std(axis=0, ddof=1) / np.sqrt(count) if count > 1 else np.zeros_like(propagated_stderr)
    place = records[0].load
    span = float(output.values[:, peak].mean())
    return LoopCurve(
        place.label,
        place.x_mm,
        place.y_mm,
        count,
        hold_s,
        peak,
        strain,
        stress.values.mean(axis=0),
        output.values.mean(axis=0) / span,
        differences.mean(axis=0),
        np.maximum(propagated_stderr, cycle_stderr),
    )


def hysteresis(curves: Sequence[LoopCurve]) -> Hysteresis:
    """Return the greatest difference of the mean over places that were pressed to the same strains.

    Places have equal weight, each relative to its own span. With noise alone the greatest of several differences is
    above zero by about its error, and so is not evidence by itself.

    NumericsError if there is no place, they were pressed to different strains, or a number is not finite.
    """
    if not curves:
        raise NumericsError("no place was pressed to strains from below and from above")
    first_curve = curves[0]
    if any(len(c.strain) != len(first_curve.strain) or not np.allclose(c.strain, first_curve.strain) for c in curves):
        raise NumericsError("the loops of different places go through different strains")
    differences = finite_numbers([curve.difference for curve in curves], "differences between the branches")
    errors = finite_numbers([curve.stderr for curve in curves], "errors of the differences")
    difference, stderr = differences.mean(axis=0), np.sqrt((errors**2).sum(axis=0)) / len(curves)
    widest = int(np.argmax(np.abs(difference)))
    widest_difference = Estimate(float(abs(difference[widest])), float(stderr[widest]), 0)
    return Hysteresis(
        widest_difference, float(first_curve.strain[first_curve.peak + 1 + widest]), bool(difference[widest] > 0)
    )


def _check_cycles(loop: LoopObservation) -> tuple[Array, int, float]:
    if loop.why:
        raise NumericsError(f"the loops cannot be evaluated: {loop.why}")
    if loop.stress is None:
        raise NumericsError(f"no stress to compare outputs at: {loop.no_force or 'no force was recorded'}")
    cycles = [np.array([hold.strain for hold in record.held]) for record in loop.records]
    strain = cycles[0]
    if any(len(other) != len(strain) or not np.allclose(other, strain) for other in cycles):
        raise NumericsError("the loops of one place go through different strains")
    peak = int(np.argmax(strain))
    if not (
        0 < peak < len(strain) - 1 and (np.diff(strain[: peak + 1]) > 0).all() and (np.diff(strain[peak:]) < 0).all()
    ):
        raise NumericsError(
            "the press did not go up through some strains and then down through some",
            remedy='press with sequence = "hysteresis-loop"',
        )
    held_s = np.array([hold.end_s - hold.start_s for record in loop.records for hold in record.held])
    if np.ptp(held_s) > _MAX_HOLD_DIFFERENCE * held_s.max():
        raise NumericsError(
            f"strains were held for {held_s.min():.3g} to {held_s.max():.3g} s: creep is not alike on both ways",
            remedy="hold every strain equally long",
        )
    return strain, peak, float(np.median(held_s))


def _differences(output: Array, stress: Array, peak: int) -> Array:
    """Falling less rising output at the falling stress, (loops, falling strains), relative to the mean span."""
    span = float(output[:, peak].mean())
    if not abs(span) > 0:
        raise NumericsError("the output at the deepest strain is zero: no share can be computed")
    differences = []
    for values, stresses in zip(output, stress, strict=True):
        rising = np.concatenate([[0.0], stresses[: peak + 1]])
        if not (np.diff(rising) > 0).all():
            raise NumericsError("the stress does not rise with the strain on the way up")
        rising_output = np.interp(stresses[peak + 1 :], rising, np.concatenate([[0.0], values[: peak + 1]]))
        differences.append((values[peak + 1 :] - rising_output) / span)
    return np.array(differences)


def _propagate_errors(output: Levels, stress: Levels, peak: int, plain: Array) -> Array:
    """Standard error of the mean difference (falling strains,) from every cause, one after the other."""
    shifted_differences = [
        *(_differences(output.values + error, stress.values, peak) for error in output.errors),
        *(_differences(output.values, stress.values + error, peak) for error in stress.errors),
    ]
    square = np.sum([(shifted.mean(axis=0) - plain) ** 2 for shifted in shifted_differences], axis=0)
    stderr: Array = np.sqrt(square)
    return stderr
