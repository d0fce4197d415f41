"""How the strength of a sensor's loads rises under a hold and fades after a release: kernels for its runtime."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.run_loads import load_window
from cbsr_qa.calibrate.common_relaxation import TimedValues
from cbsr_qa.calibrate.force_learning import RESIDUE_SHARE
from cbsr_qa.calibrate.matched import Matches, TemplateFilter
from cbsr_qa.calibrate.relaxation_kernel import learn_kernel
from cbsr_qa.calibrate.unloading import relaxation_start
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.frames import FrameBlock
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa.domain.relaxation import RelaxationKernel

Array = NDArray[np.float64]
#: Phase of a load and its number there.
LoadKey = tuple[str, int]

#: Loads that stand out less say little about a shape and cost as much time.
_LEAST_DETECTABILITY: Final = 15.0
_MOST: Final = 60
#: What earlier loads left at a place fades to its share at the steady frames with this time constant: of the order of
#: the material's own (chosen by us).
_FADING_S: Final = 25.0


def force_kernels(
    run: RunObservation, loads: Sequence[LoadObservation], places_mm: Array, merging: Array, filter_: TemplateFilter
) -> tuple[RelaxationKernel | None, RelaxationKernel | None]:
    """Learn the kernels of loading and unloading from the strength at the places of loads.

    Parameters
    ----------
    places_mm : (n, 2) of the loads, on the sheet.
    merging : from changes of used readings to rows.

    Returns
    -------
    Both; None where there is none (short holds, weak loads, no relaxation that can be told from drift).
    """
    traces = StrengthTraces(run, dict(zip(map(key_of, loads), places_mm, strict=True)), merging, filter_)
    clear = sorted(loads, key=traces.detectability, reverse=True)[:_MOST]
    clear = [load for load in clear if traces.detectability(load) >= _LEAST_DETECTABILITY]
    if not clear:
        return None, None
    return traces.loading(clear), traces.unloading(clear)


def frames_of(run: RunObservation, load: LoadObservation, from_s: float, to_s: float) -> FrameBlock | None:
    """Frames of a load's phase between two times."""
    frames = run.record.phase(load.phase).frames
    return None if frames is None else frames.between(from_s, to_s)


def key_of(load: LoadObservation) -> LoadKey:
    """What a load is known by in its run."""
    return load.phase, load.record.index


class StrengthTraces:
    """Strengths over time at the places of loads."""

    def __init__(
        self, run: RunObservation, places_mm: Mapping[LoadKey, Array], merging: Array, filter_: TemplateFilter
    ) -> None:
        self._run, self._places_mm, self._merging, self._filter = run, places_mm, merging, filter_
        self._known: dict[LoadKey, float] = {}

    def detectability(self, load: LoadObservation) -> float:
        """Of the end of the hold, in the noise of one frame."""
        key = key_of(load)
        if key not in self._known:
            _, strength, noise = self.held(load)
            self._known[key] = abs(float(strength[-4:].mean())) / noise if len(strength) else 0.0
        return self._known[key]

    def loading(self, loads: Sequence[LoadObservation]) -> RelaxationKernel | None:
        """The kernel of presses."""
        traces, ramps, noises = [], [], []
        for load in loads:
            traces.append(self.change(load))
            ramps.append(ramp_s(load))
            noises.append(self.held(load)[2])
        return _usable(traces, ramps, noises, None, 0.0)

    def change(self, load: LoadObservation) -> TimedValues:
        """Times from the start of the hold [s], and strengths under it without what earlier loads left."""
        time_s, strength, _ = self.held(load)
        return time_s, strength - self.left(load) * self.fading(time_s)

    def unloading(self, loads: Sequence[LoadObservation]) -> RelaxationKernel | None:
        """The kernel of releases."""
        traces, ramps, noises, released = [], [], [], []
        for load in loads:
            record = load.record
            _, held, _ = self.held(load)
            time_s, strength, noise = self._trace(load, record.unloaded_s, record.rest_end_s)
            if len(time_s) < 6:
                continue
            traces.append((time_s, strength))
            ramps.append(ramp_s(load))
            noises.append(noise)
            released.append(float(held[-4:].mean()))
        if not traces:
            return None
        sign = np.sign(np.mean(released))
        starts = [float(times[relaxation_start(sign * values)]) for times, values in traces]
        return _usable(traces, ramps, noises, released, float(np.median(starts)))

    def _trace(self, load: LoadObservation, from_s: float, to_s: float) -> tuple[Array, Array, float]:
        frames = frames_of(self._run, load, from_s, to_s)
        if frames is None or not len(frames):
            return np.zeros(0), np.zeros(0), 1.0
        matches = self._strengths(load, frames)
        return frames.time_s - from_s, matches.strength, float(np.sqrt(matches.covariance[0, 0, 0]))

    def held(self, load: LoadObservation) -> tuple[Array, Array, float]:
        """Times from the start of the hold [s], strengths under it, and the noise of one of them."""
        return self._trace(load, load.record.hold_start_s, load.record.release_start_s)

    @staticmethod
    def fading(time_s: Array) -> Array:
        """Share of what earlier loads left that is still there so long after the press."""
        share: Array = RESIDUE_SHARE + (1 - RESIDUE_SHARE) * np.exp(-time_s / _FADING_S)
        return share

    def left(self, load: LoadObservation) -> float:
        """Strength at the place just before the press."""
        before = load_window(self._run.record.phase(load.phase), load.record, self._run.settings).before
        return float(self._strengths(load, before).strength.mean()) if len(before) else 0.0

    def _strengths(self, load: LoadObservation, frames: FrameBlock) -> Matches:
        return self._filter.at(self._rows(frames), self._places_mm[key_of(load)])

    def _rows(self, frames: FrameBlock) -> Array:
        rows: Array = (frames.voltages - self._run.reference)[:, self._run.usable] @ self._merging.T
        return rows


def ramp_s(load: LoadObservation) -> float:
    """How long the head moved in the sheet: as long down as up."""
    return max(load.record.unloaded_s - load.record.release_start_s, 0.0)


def _usable(
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
