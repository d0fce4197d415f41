"""Transients of a run's loads: strengths at their places over time, and kernels of their rise and decay."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.analysis.run.loads import window_of
from cbsr_qa.calibration.fits.common_relaxation import TimedValues
from cbsr_qa.calibration.fits.relaxation_kernel import learn_kernel
from cbsr_qa.calibration.fits.settling import relaxation_start
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
    rises, decays = traces.rises(clearest_loads), traces.decays(clearest_loads)
    return rises.learn_usable(), None if decays is None else decays.learn_usable()


def frames_of(run: RunObservation, load: LoadObservation, from_s: float, to_s: float) -> FrameBlock | None:
    """Frames of a load's phase between two times."""
    frames = run.record.phase(load.phase).frames
    return None if frames is None else frames.select_interval(from_s, to_s)


@dataclass(frozen=True, slots=True, eq=False)
class Transients:
    """Holds or releases that a kernel is learned from; arguments as of :func:`learn_kernel`."""

    traces: tuple[TimedValues, ...]
    ramps_s: tuple[float, ...]
    noises: tuple[float, ...]
    released: tuple[float, ...] | None = None
    start_s: float = 0.0
    frame_s: float = 0.0

    @classmethod
    def join(cls, parts: "Sequence[Transients]") -> "Transients":
        """Return the holds of several runs together; releases count from the latest start of theirs on."""
        released = [number for part in parts for number in part.released or ()]
        return cls(
            tuple(trace for part in parts for trace in part.traces),
            tuple(ramp for part in parts for ramp in part.ramps_s),
            tuple(noise for part in parts for noise in part.noises),
            None if parts[0].released is None else tuple(released),
            max(part.start_s for part in parts),
            parts[0].frame_s,
        )

    def learn(self) -> RelaxationKernel:
        """Learn the kernel. NumericsError if a trace cannot be one of a hold or release."""
        return learn_kernel(
            self.traces,
            ramp_s=self.ramps_s,
            frame_s=self.frame_s,
            noise=self.noises,
            released=self.released,
            start_s=self.start_s,
        )

    def learn_usable(self) -> RelaxationKernel | None:
        """Learn the kernel; None where the traces determine none."""
        try:
            kernel = self.learn()
        except NumericsError:
            return None
        return None if kernel.why else kernel


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

    def rises(self, loads: Sequence[LoadObservation]) -> Transients:
        """Strengths under the holds of loads."""
        return Transients(
            tuple(self.change(load) for load in loads),
            tuple(ramp_s(load) for load in loads),
            tuple(self.hold_trace(load)[2] for load in loads),
        )

    def change(self, load: LoadObservation) -> TimedValues:
        """Times from the start of the hold [s], and strengths under it without residues of earlier loads."""
        time_s, strength, _ = self.hold_trace(load)
        return time_s, strength - self.residue(load) * self.fading(time_s)

    def decays(self, loads: Sequence[LoadObservation]) -> Transients | None:
        """Strengths after the releases of loads; None without frames there."""
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
        return Transients(tuple(traces), tuple(ramps), tuple(noises), tuple(released), float(np.median(starts)))

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


def steady_s(run: RunObservation, load: LoadObservation) -> float:
    """Time of the frames of a load's steady image, from the end of its ramp [s]."""
    return float(window_of(run, load).steady.time_s.mean()) - load.record.hold_start_s


def ramp_s(load: LoadObservation) -> float:
    """Return the time that the head moved in the sheet [s]: as long down as up."""
    return max(load.record.unloaded_s - load.record.release_start_s, 0.0)
