"""Loads of short holds, extrapolated to the time at which long ones were evaluated.

The longest holds of a run determine how its loads relax (conductance by the strength at their place, stress by the
load cell), or those of its batch do; with that as prior, the others are predicted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.run.force_kernels import StrengthTraces, Transients, ramp_s, steady_s
from cbsr_qa.calibration.fits.steady_state import predict_steady
from cbsr_qa.calibration.force.learning import CalibrationLoads
from cbsr_qa.calibration.force.templates import RESIDUE_SHARE
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.observation import LoadObservation, RunObservation
from cbsr_qa.domain.results.relaxation import RelaxationKernel

#: Share of the longest hold from which a load is held long enough not to be predicted.
LONG: Final = 0.9
#: Largest factor by which a prediction may change readings. After a second of hold a third of a change is present;
#: a larger factor is noise over noise, from weak loads.
LARGEST_FACTOR: Final = 5.0
#: Force samples are averaged over this time before a kernel is learned: relaxations take seconds.
_BIN_S: Final = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Compensated:
    """Loads with predicted short holds.

    Parameters
    ----------
    data : data with predicted rows and forces.
    at_s : their time after the press [s]; None if nothing was predicted.
    predicted : (n,) whether each load was.
    """

    data: CalibrationLoads
    at_s: float | None
    predicted: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class BorrowedKernels:
    """Kernels of the batch, for a run whose own holds are all shorter.

    Parameters
    ----------
    hold_s, steady_s : length of the holds that they were learned from, and time at which those were evaluated.
    strength, stress, unloading : of the conductance and of the force under a hold, and of the conductance after it.
    """

    hold_s: float
    steady_s: float
    strength: RelaxationKernel
    stress: RelaxationKernel
    unloading: RelaxationKernel | None


def compensate_loads(
    run: RunObservation,
    loads: Sequence[LoadObservation],
    data: CalibrationLoads,
    traces: StrengthTraces,
    borrowed: BorrowedKernels | None = None,
) -> Compensated:
    """Extrapolate loads of shorter holds to the time at which the longest holds were evaluated.

    Parameters
    ----------
    loads : loads of ``data``, in its order.
    traces : strengths of those loads over time.
    borrowed : kernels to use where no hold of the run is as long as theirs.

    Returns
    -------
    Compensated; loads are unchanged if all holds are equal.

    Raises
    ------
    NumericsError
        If the longest holds do not determine how conductance or stress relaxes.
    """
    held_s = np.array([load.hold_s for load in loads])
    forces = [force_trace(run, load) for load in loads]
    if borrowed is not None and held_s.max() < LONG * borrowed.hold_s:
        long, at_s = np.zeros(len(loads), dtype=np.bool_), borrowed.steady_s
        strength, stress = borrowed.strength, borrowed.stress
    else:
        long = held_s >= LONG * held_s.max()
        if long.all():
            return Compensated(data, None, ~long)
        references = list(compress(loads, long))
        at_s = float(np.mean([steady_s(run, load) for load in references]))
        strength = _usable_transients("conductance", traces.rises(references).learn_usable(), len(references))
        rises = force_rises(references, list(compress(forces, long)))
        stress = _usable_transients("stress", None if rises is None else rises.learn(), None)
    rows, frames = data.rows.copy(), data.frames.astype(np.float64)
    force, stderr = data.force_N.copy(), data.force_stderr_N.copy()
    for k in np.flatnonzero(~long).tolist():
        rows[k], frames[k] = _predict_rows(loads[k], data, k, traces, strength, at_s)
        force[k], stderr[k] = _predict_force(loads[k], forces[k], stress, at_s)
    done = replace(data, rows=rows, frames=frames, force_N=force, force_stderr_N=stderr)
    return Compensated(done, at_s, ~long)


def _usable_transients(what: str, kernel: RelaxationKernel | None, loads: int | None) -> RelaxationKernel:
    if kernel is None or kernel.why:
        holds = "the longest holds" if loads is None else f"the {loads} longest holds"
        reason = f": {kernel.why}" if kernel is not None else ""
        raise NumericsError(
            f"{holds} do not determine how the {what} relaxes{reason}: no hold can be predicted from its start",
            remedy='hold some loads for 1.5 settling times, or set transients = "averaged" in the recipe',
        )
    return kernel


def _predict_rows(
    load: LoadObservation,
    data: CalibrationLoads,
    k: int,
    traces: StrengthTraces,
    kernel: RelaxationKernel,
    at_s: float,
) -> tuple[Array, float]:
    """Steady rows scaled by the predicted rise, and the equivalent number of frames."""
    time_s, strength, noise = traces.hold_trace(load)
    if not len(time_s):
        raise NumericsError(f"load {load.record.load.label} of phase {load.phase!r} was held without taking a frame")
    residue, fading = traces.residue(load), traces.fading(time_s)
    prediction = predict_steady(time_s, strength - residue * fading, noise, kernel, ramp_s=ramp_s(load), at_s=at_s)
    # The rows are the mean of the last frames of the hold, after subtraction of the same residue.
    last_frames = slice(-int(data.frames[k]), None)
    fade = float(fading[last_frames].mean())
    window = float(strength[last_frames].mean()) - residue * fade
    factor = _limit_rise(float(prediction.values[0]), window)
    rows: Array = factor * (data.rows[k] - fade * data.before[k]) + RESIDUE_SHARE * data.before[k]
    return rows, float((noise / prediction.stderr[0]) ** 2)


def force_trace(run: RunObservation, load: LoadObservation) -> tuple[Array, Array, float]:
    """Force under a hold: times from its start [s], means over a second, and their noise."""
    samples = run.record.phase(load.phase).channel("force")
    no_samples = np.zeros(0)
    if samples is None:
        return no_samples, no_samples, 0.0
    held_samples = samples.select_interval(load.record.hold_start_s, load.record.release_start_s)
    time_s = held_samples.time_s - load.record.hold_start_s
    if len(time_s) < 2:
        return no_samples, no_samples, 0.0
    number = (time_s / _BIN_S).astype(np.intp)
    count = np.bincount(number)
    full_bins = count > 0
    times = np.bincount(number, time_s)[full_bins] / count[full_bins]
    values = np.bincount(number, held_samples.values)[full_bins] / count[full_bins]
    # From neighbouring samples, which the relaxation hardly changes.
    noise = float(np.std(np.diff(held_samples.values))) / np.sqrt(2 * float(np.median(count[full_bins])))
    return times, values, max(noise, 1e-9 * float(np.abs(values).max()))


def force_rises(loads: Sequence[LoadObservation], forces: Sequence[tuple[Array, Array, float]]) -> Transients | None:
    """Forces under the holds of loads; None if none was recorded.

    Parameters
    ----------
    forces : of each load, as :func:`force_trace` returns them.
    """
    recorded = [k for k, (times, _, _) in enumerate(forces) if len(times)]
    if not recorded:
        return None
    return Transients(
        tuple(forces[k][:2] for k in recorded),
        tuple(ramp_s(loads[k]) for k in recorded),
        tuple(forces[k][2] for k in recorded),
        frame_s=_BIN_S,
    )


def _predict_force(
    load: LoadObservation, trace: tuple[Array, Array, float], kernel: RelaxationKernel, at_s: float
) -> tuple[float, float]:
    times, values, noise = trace
    if not len(times):
        raise NumericsError(f"no force was recorded under load {load.record.load.label} of phase {load.phase!r}")
    prediction = predict_steady(times, values, noise, kernel, ramp_s=ramp_s(load), frame_s=_BIN_S, at_s=at_s)
    return float(prediction.values[0]), float(prediction.stderr[0])


def _limit_rise(predicted: float, seen: float) -> float:
    """Limit the scale of readings: no load may seem to rise or fall by more than its noise."""
    return float(np.clip(predicted / seen, 1 / LARGEST_FACTOR, LARGEST_FACTOR)) if seen else 1.0
