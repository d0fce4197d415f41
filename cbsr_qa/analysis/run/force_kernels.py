"""Transients of a run's loads: kernels of their rise and decay, and short holds extrapolated to the longest.

The longest holds of a run determine how its loads relax (conductance by the strength at their place, stress by the
load cell); with that as prior, the others are predicted to the time at which those are evaluated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.run.loads import window_of
from cbsr_qa.calibration.fits.common_relaxation import TimedValues
from cbsr_qa.calibration.fits.relaxation_kernel import learn_kernel
from cbsr_qa.calibration.fits.settling import relaxation_start
from cbsr_qa.calibration.fits.steady_state import predict_steady
from cbsr_qa.calibration.force.learning import CalibrationLoads
from cbsr_qa.calibration.force.template_matching import Matches, TemplateFilter
from cbsr_qa.calibration.force.templates import RESIDUE_SHARE
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.frames import FrameBlock
from cbsr_qa.domain.results.observation import LoadObservation, RunObservation
from cbsr_qa.domain.results.relaxation import RelaxationKernel

#: Key of a load: its phase and its index there.
LoadKey = tuple[str, int]

#: Least detectability of a load that is used: weaker ones contribute little to a shape and cost as much time.
_LEAST_DETECTABILITY: Final = 15.0
_MAX_LOADS: Final = 60
#: Time constant with which residues of earlier loads decay to their share at the steady frames: of the order of the
#: material's own (chosen by us).
_FADING_S: Final = 25.0


def force_kernels(
    run: RunObservation, loads: Sequence[LoadObservation], places_mm: Array, merging: Array, filter_: TemplateFilter
) -> tuple[RelaxationKernel | None, RelaxationKernel | None]:
    """Learn the kernels of loading and unloading from the strength at the places of loads.

    Parameters
    ----------
    places_mm : (n, 2) places of the loads, on the sheet.
    merging : maps changes of used readings to rows.

    Returns
    -------
    Both; None for short holds, weak loads, or relaxation that cannot be separated from drift.
    """
    traces = StrengthTraces(run, dict(zip(map(key_of, loads), places_mm, strict=True)), merging, filter_)
    clearest_loads = sorted(loads, key=traces.detectability, reverse=True)[:_MAX_LOADS]
    clearest_loads = [load for load in clearest_loads if traces.detectability(load) >= _LEAST_DETECTABILITY]
    if not clearest_loads:
        return None, None
    return traces.loading(clearest_loads), traces.unloading(clearest_loads)


def frames_of(run: RunObservation, load: LoadObservation, from_s: float, to_s: float) -> FrameBlock | None:
    """Frames of a load's phase between two times."""
    frames = run.record.phase(load.phase).frames
    return None if frames is None else frames.select_interval(from_s, to_s)


def key_of(load: LoadObservation) -> LoadKey:
    """Identity of a load in its run."""
    return load.phase, load.record.index


class StrengthTraces:
    """Strengths over time at the places of loads."""

    def __init__(
        self, run: RunObservation, places_mm: Mapping[LoadKey, Array], merging: Array, filter_: TemplateFilter
    ) -> None:
        self._run, self._places_mm, self._merging, self._filter = run, places_mm, merging, filter_
        self._known: dict[LoadKey, float] = {}

    def detectability(self, load: LoadObservation) -> float:
        """Detectability at the end of the hold, in the noise of one frame."""
        key = key_of(load)
        if key not in self._known:
            _, strength, noise = self.hold_trace(load)
            self._known[key] = abs(float(strength[-4:].mean())) / noise if len(strength) else 0.0
        return self._known[key]

    def loading(self, loads: Sequence[LoadObservation]) -> RelaxationKernel | None:
        noises = [self.hold_trace(load)[2] for load in loads]
        return _learn_usable_kernel(
            [self.change(load) for load in loads], [ramp_s(load) for load in loads], noises, None, 0.0
        )

    def change(self, load: LoadObservation) -> TimedValues:
        """Times from the start of the hold [s], and strengths under it without residues of earlier loads."""
        time_s, strength, _ = self.hold_trace(load)
        return time_s, strength - self.residue(load) * self.fading(time_s)

    def unloading(self, loads: Sequence[LoadObservation]) -> RelaxationKernel | None:
        traces, ramps, noises, released = [], [], [], []
        for load in loads:
            record = load.record
            _, held_strength, _ = self.hold_trace(load)
            time_s, strength, noise = self._trace(load, record.unloaded_s, record.rest_end_s)
            if len(time_s) < 6:
                continue
            traces.append((time_s, strength))
            ramps.append(ramp_s(load))
            noises.append(noise)
            released.append(float(held_strength[-4:].mean()))
        if not traces:
            return None
        sign = np.sign(np.mean(released))
        starts = [float(times[relaxation_start(sign * values)]) for times, values in traces]
        return _learn_usable_kernel(traces, ramps, noises, released, float(np.median(starts)))

    def _trace(self, load: LoadObservation, from_s: float, to_s: float) -> tuple[Array, Array, float]:
        frames = frames_of(self._run, load, from_s, to_s)
        if frames is None or not len(frames):
            return np.zeros(0), np.zeros(0), 1.0
        matches = self._match_strengths(load, frames)
        return frames.time_s - from_s, matches.strength, float(np.sqrt(matches.covariance[0, 0, 0]))

    def hold_trace(self, load: LoadObservation) -> tuple[Array, Array, float]:
        """Times from the start of the hold [s], strengths under it, and the noise of one of them."""
        return self._trace(load, load.record.hold_start_s, load.record.release_start_s)

    @staticmethod
    def fading(time_s: Array) -> Array:
        """Share of earlier loads' residue that remains this long after the press."""
        return RESIDUE_SHARE + (1 - RESIDUE_SHARE) * np.exp(-time_s / _FADING_S)

    def residue(self, load: LoadObservation) -> float:
        """Strength at the place just before the press."""
        frames_before = window_of(self._run, load).before
        return float(self._match_strengths(load, frames_before).strength.mean()) if len(frames_before) else 0.0

    def _match_strengths(self, load: LoadObservation, frames: FrameBlock) -> Matches:
        rows = (frames.voltages - self._run.reference)[:, self._run.usable] @ self._merging.T
        return self._filter.match_at(rows, self._places_mm[key_of(load)])


def ramp_s(load: LoadObservation) -> float:
    """Return the time that the head moved in the sheet [s]: as long down as up."""
    return max(load.record.unloaded_s - load.record.release_start_s, 0.0)


def _learn_usable_kernel(
    traces: Sequence[tuple[Array, Array]],
    ramps: Sequence[float],
    noises: Sequence[float],
    released: Sequence[float] | None,
    start_s: float,
) -> RelaxationKernel | None:
    try:
        kernel = learn_kernel(traces, ramp_s=ramps, noise=noises, released=released, start_s=start_s)
    except NumericsError:
        return None
    return None if kernel.why else kernel


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


def compensate_loads(
    run: RunObservation, loads: Sequence[LoadObservation], data: CalibrationLoads, traces: StrengthTraces
) -> Compensated:
    """Extrapolate loads of shorter holds to the time at which the longest holds were evaluated.

    Parameters
    ----------
    loads : loads of ``data``, in its order.
    traces : strengths of those loads over time.

    Returns
    -------
    Compensated; loads are unchanged if all holds are equal.

    Raises
    ------
    NumericsError
        If the longest holds do not determine how conductance or stress relaxes.
    """
    held_s = np.array([load.hold_s for load in loads])
    long = held_s >= LONG * held_s.max()
    if long.all():
        return Compensated(data, None, ~long)
    references = list(compress(loads, long))
    at_s = float(np.mean([steady_s(run, load) for load in references]))
    strength = _usable_transients("conductance", traces.loading(references), len(references))
    forces = [_force_trace(run, load) for load in loads]
    stress = _usable_transients("stress", _stress_kernel(references, list(compress(forces, long))), None)
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


def steady_s(run: RunObservation, load: LoadObservation) -> float:
    """Time of the frames of a load's steady image, from the end of its ramp [s]."""
    return float(window_of(run, load).steady.time_s.mean()) - load.record.hold_start_s


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


def _force_trace(run: RunObservation, load: LoadObservation) -> tuple[Array, Array, float]:
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


def _stress_kernel(
    loads: Sequence[LoadObservation], forces: Sequence[tuple[Array, Array, float]]
) -> RelaxationKernel | None:
    recorded = [k for k, (times, _, _) in enumerate(forces) if len(times)]
    if not recorded:
        return None
    return learn_kernel(
        [forces[k][:2] for k in recorded],
        ramp_s=[ramp_s(loads[k]) for k in recorded],
        frame_s=_BIN_S,
        noise=[forces[k][2] for k in recorded],
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
