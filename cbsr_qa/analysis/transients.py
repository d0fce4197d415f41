"""Transient compensation of a calibration: short holds brought to where the run's longest ones end.

The longest holds of a run say how its loads relax (conductance by the strength at their place, stress by the load
cell); with that as prior, the others are predicted to the time at which those were looked at.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.force_kernels import StrengthTraces, ramp_s
from cbsr_qa.analysis.run_loads import load_window
from cbsr_qa.calibrate.force_learning import RESIDUE_SHARE, CalibrationLoads
from cbsr_qa.calibrate.steady_state import learn_kernel, predict_steady
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa.domain.relaxation import RelaxationKernel

Array = NDArray[np.float64]

#: Loads held for this share of the longest hold are looked at as they are.
LONG: Final = 0.9
#: Most that a prediction may raise or lower readings. After a second of hold a third of a change is there; more is
#: noise over noise, of loads that say nothing.
LARGEST_FACTOR: Final = 5.0
#: Force samples are averaged over this before a kernel is learned from them: relaxations take seconds.
_BIN_S: Final = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Compensated:
    """Loads of which short holds were predicted.

    Parameters
    ----------
    data : with predicted rows and forces.
    at_s : time after the press they are of [s]; None where nothing was predicted.
    predicted : (n,) whether each load was.
    """

    data: CalibrationLoads
    at_s: float | None
    predicted: NDArray[np.bool_]


def compensated(
    run: RunObservation, loads: Sequence[LoadObservation], data: CalibrationLoads, traces: StrengthTraces
) -> Compensated:
    """Bring loads that were held for a shorter time to where the longest holds were looked at.

    Parameters
    ----------
    loads : of ``data``, in its order.
    traces : strengths of those loads over time.

    Returns
    -------
    Compensated, with the loads as they were where all were held alike.

    Raises
    ------
    NumericsError
        If the longest holds do not say how conductance or stress relaxes.
    """
    held_s = np.array([load.record.release_start_s - load.record.hold_start_s for load in loads])
    long = held_s >= LONG * held_s.max()
    if long.all():
        return Compensated(data, None, ~long)
    steady_s = [_steady_s(run, load) for load, yes in zip(loads, long, strict=True) if yes]
    at_s = float(np.mean(steady_s))
    references = [load for load, yes in zip(loads, long, strict=True) if yes]
    strength = _usable("conductance", traces.loading(references), len(references))
    forces = [_force_trace(run, load) for load in loads]
    stress = _usable("stress", _stress_kernel(references, [f for f, y in zip(forces, long, strict=True) if y]), None)
    rows, frames = data.rows.copy(), data.frames.astype(np.float64)
    force, stderr = data.force_N.copy(), data.force_stderr_N.copy()
    for k in np.flatnonzero(~long).tolist():
        rows[k], frames[k] = _predicted_rows(loads[k], data, k, traces, strength, at_s)
        force[k], stderr[k] = _predicted_force(loads[k], forces[k], stress, at_s)
    done = replace(data, rows=rows, frames=frames, force_N=force, force_stderr_N=stderr)
    return Compensated(done, at_s, ~long)


def _usable(what: str, kernel: RelaxationKernel | None, loads: int | None) -> RelaxationKernel:
    if kernel is None or kernel.why:
        of = "the longest holds" if loads is None else f"the {loads} longest holds"
        why = f": {kernel.why}" if kernel is not None else ""
        raise NumericsError(
            f"{of} do not say how the {what} relaxes{why}: no hold can be predicted from its first part",
            remedy='hold some loads for 1.5 settling times, or set transients = "averaged" in the recipe',
        )
    return kernel


def _steady_s(run: RunObservation, load: LoadObservation) -> float:
    window = load_window(run.record.phase(load.phase), load.record, run.settings)
    return float(window.steady.time_s.mean()) - load.record.hold_start_s


def _predicted_rows(
    load: LoadObservation,
    data: CalibrationLoads,
    k: int,
    traces: StrengthTraces,
    kernel: RelaxationKernel,
    at_s: float,
) -> tuple[Array, float]:
    """Steady rows scaled by what is still to come, and as many frames as would be as sure of their strength."""
    time_s, strength, noise = traces.held(load)
    if not len(time_s):
        raise NumericsError(f"load {load.record.load.label} of phase {load.phase!r} was held without taking a frame")
    left, fading = traces.left(load), traces.fading(time_s)
    seen = predict_steady(time_s, strength - left * fading, noise, kernel, ramp_s=ramp_s(load), at_s=at_s)
    # The rows are the mean of the last frames of the hold, of which the same was left.
    last = slice(-int(data.frames[k]), None)
    fade = float(fading[last].mean())
    window = float(strength[last].mean()) - left * fade
    factor = _within(float(seen.values[0]), window)
    rows: Array = factor * (data.rows[k] - fade * data.before[k]) + RESIDUE_SHARE * data.before[k]
    return rows, float((noise / seen.stderr[0]) ** 2)


def _within(predicted: float, seen: float) -> float:
    """What readings are scaled by: no load rises or falls by more than noise can make it seem to."""
    return float(np.clip(predicted / seen, 1 / LARGEST_FACTOR, LARGEST_FACTOR)) if seen else 1.0


def _force_trace(run: RunObservation, load: LoadObservation) -> tuple[Array, Array, float]:
    """Force under a hold: times from its start [s], means over a second, and their noise."""
    samples = run.record.phase(load.phase).channel("force")
    none = np.zeros(0)
    if samples is None:
        return none, none, 0.0
    taken = samples.between(load.record.hold_start_s, load.record.release_start_s)
    time_s = taken.time_s - load.record.hold_start_s
    if len(time_s) < 2:
        return none, none, 0.0
    number = (time_s / _BIN_S).astype(np.intp)
    count = np.bincount(number)
    full = count > 0
    times = np.bincount(number, time_s)[full] / count[full]
    values = np.bincount(number, taken.values)[full] / count[full]
    # Of neighbouring samples, which the relaxation hardly changes.
    noise = float(np.std(np.diff(taken.values))) / np.sqrt(2 * float(np.median(count[full])))
    return times, values, max(noise, 1e-9 * float(np.abs(values).max()))


def _stress_kernel(
    loads: Sequence[LoadObservation], forces: Sequence[tuple[Array, Array, float]]
) -> RelaxationKernel | None:
    told = [k for k, (times, _, _) in enumerate(forces) if len(times)]
    if not told:
        return None
    return learn_kernel(
        [forces[k][:2] for k in told],
        ramp_s=[ramp_s(loads[k]) for k in told],
        frame_s=_BIN_S,
        noise=[forces[k][2] for k in told],
    )


def _predicted_force(
    load: LoadObservation, trace: tuple[Array, Array, float], kernel: RelaxationKernel, at_s: float
) -> tuple[float, float]:
    times, values, noise = trace
    if not len(times):
        raise NumericsError(f"no force was recorded under load {load.record.load.label} of phase {load.phase!r}")
    seen = predict_steady(times, values, noise, kernel, ramp_s=ramp_s(load), frame_s=_BIN_S, at_s=at_s)
    return float(seen.values[0]), float(seen.stderr[0])
